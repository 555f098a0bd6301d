// Surfaces as meshes, in their body's frame; the picture's top left corner has (0, 0) in `uv`.
import { BufferAttribute, BufferGeometry } from "../vendor/three.js";
import { place } from "../lens.js";

/** @import { Surface } from "../types.js" */

/** @param {Surface} surface as /api/v1/scene has it */
export function meshOf(surface) {
  const rows = surface.mesh_m ?? flat(surface);
  const [down, across] = [rows.length - 1, rows[0].length - 1];
  const uv = rows.flatMap((row, j) => row.flatMap((_, i) => [i / across, j / down]));
  /** @type {number[]} */
  const triangles = [];
  for (let j = 0; j < down; j += 1) {
    for (let i = 0; i < across; i += 1) {
      const [a, b] = [j * (across + 1) + i, (j + 1) * (across + 1) + i];
      triangles.push(a, b, b + 1, a, b + 1, a + 1);
    }
  }
  const mesh = new BufferGeometry();
  mesh.setAttribute("position", new BufferAttribute(new Float32Array(rows.flat(2)), 3));
  mesh.setAttribute("uv", new BufferAttribute(new Float32Array(uv), 2));
  mesh.setIndex(triangles);
  mesh.computeVertexNormals();
  return mesh;
}

/** @param {Surface} surface */
function flat({ size_m: [w, h], pose }) {
  return [h / 2, -h / 2].map((y) => [-w / 2, w / 2].map((x) => place(pose, [x, y, 0])));
}
