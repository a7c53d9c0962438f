// Arrays from the text that warpqem/report/encoding.py and mesh_data.py make of them.

// Deflated bytes (RFC 1950) in base64.
async function inflate(text) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Values from byte planes: the lowest bytes of all values come first.
function joinPlanes(bytes, Type) {
  const width = Type.BYTES_PER_ELEMENT;
  const count = bytes.length / width;
  const values = new Type(count);
  for (let plane = 0; plane < width; plane += 1) {
    const start = plane * count;
    for (let i = 0; i < count; i += 1) values[i] |= bytes[start + i] << (8 * plane);
  }
  return values;
}

// Rows of `length` values: the first is whole, the others are differences, modulo the width of the type.
function addUp(values, length) {
  for (let i = length; i < values.length; i += 1) values[i] += values[i - length];
  return values;
}

// A mesh of the data: positions as 16-bit nodes of the grid for all frames, faces of wedges and what these are of.
async function decodeMesh(mesh, frameCount) {
  const uvText = mesh.uv ? mesh.uv.nodes : null;
  const [points, faces, features, heat, wedges, smooth, colors, uvs] = await Promise.all(
    [mesh.points, mesh.faces, mesh.features, mesh.heat, mesh.wedges, mesh.smooth, mesh.colors, uvText].map((text) =>
      text === null ? null : inflate(text)
    )
  );
  const vertices = () => Uint32Array.from({ length: mesh.vertexCount }, (_, vertex) => vertex);
  const wedgeVertex = wedges ? addUp(joinPlanes(wedges, Uint32Array), 1) : vertices();
  return {
    vertexCount: mesh.vertexCount,
    faceCount: mesh.faceCount,
    frameCount,
    nodes: addUp(joinPlanes(points, Uint16Array), 3 * mesh.vertexCount),
    faces: joinPlanes(faces, Uint32Array),
    wedgeVertex,
    // Wedges of one group are shaded as one surface.
    group: smooth ? addUp(joinPlanes(smooth, Uint32Array), 1) : wedgeVertex,
    features,
    heat,
    heatScale: mesh.heatScale,
    colors,
    uvs: uvs ? { ...mesh.uv, nodes: joinPlanes(uvs, Uint16Array) } : null,
    parts: mesh.parts,
  };
}
