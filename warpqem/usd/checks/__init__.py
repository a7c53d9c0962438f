"""Files and values looked at before and after USD reads them. Imports no other room of USD."""
