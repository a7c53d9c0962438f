"""Linear blend skins of simplified meshes."""
