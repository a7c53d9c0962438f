// Arrays from the text that warpqem/report/encoding.py makes of them.

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

// A mesh of the data: positions as 16-bit nodes of the grid for all frames, faces, features and distances.
async function decodeMesh(mesh, frameCount) {
  const [points, faces, features, heat] = await Promise.all(
    [mesh.points, mesh.faces, mesh.features, mesh.heat].map((text) => (text === null ? null : inflate(text)))
  );
  const nodes = joinPlanes(points, Uint16Array);
  const length = 3 * mesh.vertexCount;
  // The first frame is whole, the others are differences, modulo 2^16.
  for (let i = length; i < length * frameCount; i += 1) nodes[i] += nodes[i - length];
  return {
    vertexCount: mesh.vertexCount,
    faceCount: mesh.faceCount,
    nodes,
    faces: joinPlanes(faces, Uint32Array),
    features,
    heat,
    heatScale: mesh.heatScale,
  };
}
