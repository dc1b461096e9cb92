"use strict";
// The data of the page: runs as of view/recorded.py, lengths in data.unit [m], quaternions in data.turn; or a report as
// of optimize/gait_page.py.  What is not there is not drawn.
const data = { models: [], runs: [], plots: [], notes: [], ...JSON.parse(document.getElementById("data").textContent) };
const FAR = 2.4;            // distance of the eye by the width that is seen
const ARROW = 0.35;         // length of a force of the whole weight, by the width that is seen at first
const KEPT = 240;           // durations of frames that are kept
const FEW = 3;              // members of a scene whose states are told one by one
const $ = id => document.getElementById(id);
const media = query => window.matchMedia ? window.matchMedia(query) : { matches: false, addEventListener() {} };
const still = media("(prefers-reduced-motion: reduce)").matches;

const start = Math.min(...data.runs.map(run => run.times[0]));
const end = Math.max(...data.runs.map(run => Math.max(run.end, run.times.at(-1))));
const view = { yaw: -1.1, pitch: 0.3, span: data.span, low: data.low || 1, pan: [0, 0, 0] };  // low: of the span, what has to fit in height
const shown = { follow: true, forces: true, prints: true, rays: true, load: false, meshes: true, ghosts: data.ghosts && data.runs.length > 1 };
const state = { time: start, playing: !still && end > start, dirty: true, touched: -Infinity, drawn: -Infinity };
const hands = { grab: () => false, drag: () => false, drop() {}, pull() {}, words: since => [since] };  // of view/drive.js
const frames = [];          // how long each of the last frames took to draw [ms]
let colors = {};

function readColors() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["page", "text", "soft", "line", "sky", "ground", "square", "shadow", "edge", "force", "pressure",
    "support", "grid", "water", "paint", "ray", "bad", "badpage", "left", "right", "mid"]) colors[name] = style.getPropertyValue("--" + name).trim();
  colors.clear = colors.ground + "00";  // #rrggbb, transparent
  colors.lines = style.getPropertyValue("--lines").trim().split(/\s+/);
}

// ------------------------------------------------------------------------------------------- robots

const gray = color => {
  const x = 0.3 * color[0] + 0.59 * color[1] + 0.11 * color[2];
  return color.map(c => Math.round(0.7 * x + 0.3 * c));
};

const models = data.models.map(model => ({
  ...model,
  bodies: model.bodies.map(body => {
    const points = Float64Array.from(body.points, x => x * data.unit), normals = new Float64Array(3 * body.faces.length);
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    points.forEach((x, k) => { low[k % 3] = Math.min(low[k % 3], x); high[k % 3] = Math.max(high[k % 3], x); });
    body.faces.forEach((face, k) => {  // of any polygon (Newell)
      const n = [0, 0, 0];
      face.forEach((i, j) => {
        const a = 3 * i, b = 3 * face[(j + 1) % face.length];
        n[0] += (points[a + 1] - points[b + 1]) * (points[a + 2] + points[b + 2]);
        n[1] += (points[a + 2] - points[b + 2]) * (points[a] + points[b]);
        n[2] += (points[a] - points[b]) * (points[a + 1] + points[b + 1]);
      });
      const length = Math.hypot(...n) || 1;
      for (let i = 0; i < 3; i++) normals[3 * k + i] = n[i] / length;
    });
    const color = body.faces.map((_, k) => body.palette[body.colors.length ? body.colors[k] : 0]);
    return { ...body, points, normals, color, pale: color.map(gray), low, high, screen: new Float64Array(points.length) };
  }),
}));

const walks = run => models[run.model].moves && models[run.model].joints.length > 0;
const lead = runs => runs.find(walks) || runs[0];  // what the camera follows, and the words under a picture are about
const FOLLOWS = !data.together || Boolean(data.live) || data.runs.some(walks);

function place(run, t) {  // frame and how far to the next
  const times = run.times;
  let a = 0, b = times.length - 1;
  if (t >= times[b]) return [b, b, 0];
  if (t <= times[0]) return [0, 0, 0];
  while (b - a > 1) { const m = (a + b) >> 1; if (times[m] <= t) a = m; else b = m; }
  return [a, b, (t - times[a]) / (times[b] - times[a])];
}

function poses(run, t) {  // of each body: x y z and the rotation by rows
  const [k, m, f] = place(run, t), a = run.frames[k], b = run.frames[m], out = [];
  for (let i = 0; i < a.length; i += 7) {
    const v = [];
    for (let j = 0; j < 7; j++) v.push(a[i + j] + f * (b[i + j] - a[i + j]));
    const n = Math.hypot(v[3], v[4], v[5], v[6]), x = v[3] / n, y = v[4] / n, z = v[5] / n, w = v[6] / n;
    out.push([data.unit * v[0], data.unit * v[1], data.unit * v[2],
      1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
      2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
      2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]);
  }
  return out;
}

const mixed = (a, b, f, scale) => a.map((x, k) => scale * (x + f * (b[k] - x)));

// ------------------------------------------------------------------------------------------- camera

function camera(w, h, center) {
  const cy = Math.cos(view.yaw), sy = Math.sin(view.yaw), cp = Math.cos(view.pitch), sp = Math.sin(view.pitch);
  const back = [cp * cy, cp * sy, sp], right = [-sy, cy, 0], up = [-sp * cy, -sp * sy, cp];
  const distance = FAR * view.span, focus = FAR * Math.min(w, h / (0.82 * view.low)), near = 0.05 * distance;
  const eye = center.map((x, k) => x + distance * back[k]);
  const toward = p => {  // right, up, depth
    const x = p[0] - eye[0], y = p[1] - eye[1], z = p[2] - eye[2];
    return [right[0] * x + right[1] * y, up[0] * x + up[1] * y + up[2] * z, -(back[0] * x + back[1] * y + back[2] * z)];
  };
  const flat = q => [w / 2 + focus * q[0] / q[2], h / 2 - focus * q[1] / q[2], q[2]];
  const see = p => flat(toward(p));
  const clipped = points => {  // a polygon in front of the eye
    const q = points.map(toward), out = [];
    q.forEach((a, k) => {
      const b = q[(k + 1) % q.length];
      if (a[2] >= near) out.push(flat(a));
      if ((a[2] < near) !== (b[2] < near)) {
        const f = (near - a[2]) / (b[2] - a[2]);
        out.push(flat([a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1]), near]));
      }
    });
    return out;
  };
  return { w, h, center, eye, right, up, back, focus, near, see, clipped, pixels: focus / distance };
}

function trace(g, points) {
  points.forEach((p, k) => k ? g.lineTo(p[0], p[1]) : g.moveTo(p[0], p[1]));
  g.closePath();
}

// ------------------------------------------------------------------------------------------- ground

function square() {  // its edge [m]: 1, 2 or 5 times a power of ten, so that a few cross the picture at any zoom
  const least = view.span / 14, ten = 10 ** Math.floor(Math.log10(least));
  return ten * [1, 2, 5, 10].find(k => k * ten >= least);
}

function ground(g, cam, floor) {
  if (floor.quads) { relief(g, cam, floor); return; }
  const z = floor.height, [cx, cy] = cam.center, s = square();
  if (cam.eye[2] <= z) return;  // from below
  const field = (x0, x1, y0, y1) => cam.clipped([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]);
  const horizon = Math.max(0, cam.h / 2 - cam.focus * Math.tan(Math.min(view.pitch, 1.5)));
  g.fillStyle = colors.ground;
  g.fillRect(0, horizon, cam.w, cam.h - horizon);
  const n = Math.ceil(2.4 * view.span / s), i0 = 2 * Math.round(cx / s / 2), j0 = 2 * Math.round(cy / s / 2);
  const [x0, x1, y0, y1] = [(i0 - n) * s, (i0 + n) * s, (j0 - n) * s, (j0 + n) * s];
  g.beginPath();
  if (floor.real) {  // stripes both ways: where an odd number lies upon another, even-odd filling leaves a chessboard
    for (let k = -n; k < n; k += 2) {
      trace(g, field((i0 + k) * s, (i0 + k + 1) * s, y0, y1));
      trace(g, field(x0, x1, (j0 + k) * s, (j0 + k + 1) * s));
    }
    g.fillStyle = colors.square;
    g.fill("evenodd");
    haze(g, cam);
  } else {
    for (let k = -n; k <= n; k++) {
      trace(g, field((i0 + k) * s, (i0 + k) * s, y0, y1));
      trace(g, field(x0, x1, (j0 + k) * s, (j0 + k) * s));
    }
    g.strokeStyle = colors.square;
    g.lineWidth = 1;
    g.stroke();
  }
}

function haze(g, cam) {  // squares too far away to be told apart go over into one color
  const horizon = cam.h / 2 - cam.focus * Math.tan(Math.min(view.pitch, 1.5)), low = horizon + 0.45 * cam.h;
  if (low < 0) return;
  const fade = g.createLinearGradient(0, horizon, 0, low);
  fade.addColorStop(0, colors.ground);
  fade.addColorStop(1, colors.clear);
  g.fillStyle = fade;
  g.fillRect(0, Math.max(0, horizon), cam.w, Math.max(0, low - Math.max(0, horizon)));
}

function relief(g, cam, floor) {
  const order = floor.quads.map((q, k) => {
    const x = [0, 3, 6, 9].map(i => [q[i], q[i + 1], q[i + 2]]);
    return { x, k, depth: cam.see([(q[0] + q[6]) / 2, (q[1] + q[7]) / 2, (q[2] + q[8]) / 2])[2] };
  }).sort((a, b) => b.depth - a.depth);
  g.lineWidth = 0.5;
  for (const { x, k } of order) {
    g.beginPath();
    trace(g, cam.clipped(x));
    g.fillStyle = g.strokeStyle = [colors.ground, colors.square, colors.shadow][floor.shade[k]];
    g.fill();
    g.stroke();
  }
}

function shadow(g, cam, bodies, at, floor) {  // of a lamp straight above; upper sides of boxes around the bodies
  if (floor.quads) return;
  const SIDES = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
  const NORMAL = [[2, -1], [2, 1], [1, -1], [1, 1], [0, -1], [0, 1]];
  g.beginPath();
  bodies.forEach((body, b) => {
    const p = at[b], corner = [];
    for (let k = 0; k < 8; k++) {
      const x = k & 1 ? body.high[0] : body.low[0], y = k & 2 ? body.high[1] : body.low[1], z = k & 4 ? body.high[2] : body.low[2];
      corner.push([p[0] + p[3] * x + p[4] * y + p[5] * z, p[1] + p[6] * x + p[7] * y + p[8] * z, floor.height]);
    }
    SIDES.forEach((side, k) => { if (p[9 + NORMAL[k][0]] * NORMAL[k][1] > 0) trace(g, cam.clipped(side.map(i => corner[i]))); });
  });
  g.fillStyle = colors.shadow;
  g.fill("nonzero");
}

// ------------------------------------------------------------------------------------------- bodies

const fills = new Map();
function fill(color, light) {
  const key = (color[0] << 21) | (color[1] << 13) | (color[2] << 5) | light;
  let text = fills.get(key);
  if (!text) {
    const f = 0.42 + 0.62 * light / 31;
    text = "rgb(" + color.map(x => Math.min(255, Math.round(x * f))) + ")";
    fills.set(key, text);
  }
  return text;
}

function loadColor(percent) {  // pale to dark, through yellow and red: its lightness falls all the way
  const stops = [[236, 236, 230], [250, 214, 110], [238, 130, 50], [190, 40, 40], [90, 10, 50]];
  const x = Math.min(3.999, Math.max(0, percent / 25)), k = Math.floor(x), f = x - k;
  return stops[k].map((a, i) => Math.round((a + f * (stops[k + 1][i] - a)) / 8) * 8);
}

function water(g, cam, level) {  // an even surface, up to where the picture ends
  const [cx, cy] = cam.center, far = 300 * view.span;
  g.beginPath();
  trace(g, cam.clipped([[cx - far, cy - far, level], [cx + far, cy - far, level], [cx + far, cy + far, level], [cx - far, cy + far, level]]));
  g.fillStyle = colors.water;
  g.fill();
}

function cut(face, heights, s, above) {  // the part of a face on one side of a level, in the picture
  const out = [];
  face.forEach((i, k) => {
    const j = face[(k + 1) % face.length], a = above * heights[i], b = above * heights[j];
    if (a >= 0) out.push([s[3 * i], s[3 * i + 1]]);
    if ((a < 0) !== (b < 0)) out.push([0, 1].map(x => s[3 * i + x] + a / (a - b) * (s[3 * j + x] - s[3 * i + x])));
  });
  return out;
}

function robot(g, cam, model, at, { tint, pale, ratio }, level = 0, above = 0) {  // above: 1 or -1, of what is over or below a level alone
  if (shown.meshes && gl && model.array && !(slow && moving())) { fullRobot(g, cam, model, at, { tint, pale }, level, above); return; }
  const faces = [], L = [0.29, -0.42, 0.86];
  model.bodies.forEach((body, b) => {
    const p = at[b], x = body.points, s = body.screen, n = body.normals;
    const [ex, ey, ez] = [cam.eye[0] - p[0], cam.eye[1] - p[1], cam.eye[2] - p[2]];  // eye, light and axes of the
    const e = [p[3] * ex + p[6] * ey + p[9] * ez, p[4] * ex + p[7] * ey + p[10] * ez, p[5] * ex + p[8] * ey + p[11] * ez];
    const turn = v => [p[3] * v[0] + p[6] * v[1] + p[9] * v[2], p[4] * v[0] + p[7] * v[1] + p[10] * v[2], p[5] * v[0] + p[8] * v[1] + p[11] * v[2]];
    const r = turn(cam.right), u = turn(cam.up), t = turn(cam.back), l = turn(L);  // picture in the link's axes
    for (let i = 0; i < x.length; i += 3) {
      const dx = x[i] - e[0], dy = x[i + 1] - e[1], dz = x[i + 2] - e[2];
      const depth = -(t[0] * dx + t[1] * dy + t[2] * dz), scale = cam.focus / Math.max(depth, cam.near);
      s[i] = cam.w / 2 + scale * (r[0] * dx + r[1] * dy + r[2] * dz);
      s[i + 1] = cam.h / 2 - scale * (u[0] * dx + u[1] * dy + u[2] * dz);
      s[i + 2] = depth;
    }
    const heights = above ? Array.from({ length: x.length / 3 }, (_, k) => p[2] + p[9] * x[3 * k] + p[10] * x[3 * k + 1] + p[11] * x[3 * k + 2] - level) : null;
    const color = tint && tint(b);
    for (let k = 0; k < body.faces.length; k++) {
      const face = body.faces[k], a = 3 * face[0], m = 3 * k;
      const behind = n[m] * (e[0] - x[a]) + n[m + 1] * (e[1] - x[a + 1]) + n[m + 2] * (e[2] - x[a + 2]) <= 0;
      if (behind && !body.open) continue;
      let depth = 0, least = Infinity;
      for (const i of face) { depth += s[3 * i + 2]; least = Math.min(least, s[3 * i + 2]); }
      if (least < cam.near) continue;
      const bright = (behind ? -1 : 1) * (n[m] * l[0] + n[m + 1] * l[1] + n[m + 2] * l[2]);
      const part = heights && cut(face, heights, s, above);
      if (part && part.length < 3) continue;
      faces.push({ body, face, part, depth: depth / face.length, style: fill(color || (pale ? body.pale[k] : body.color[k]), Math.round(15.5 + 15.5 * bright)) });
    }
  });
  faces.sort((a, b) => b.depth - a.depth);
  g.lineJoin = "round";
  for (const { body, face, part, style } of faces) {
    const s = body.screen;
    g.beginPath();
    if (part) part.forEach((p, k) => k ? g.lineTo(p[0], p[1]) : g.moveTo(p[0], p[1]));
    else {
      g.moveTo(s[3 * face[0]], s[3 * face[0] + 1]);
      for (let k = 1; k < face.length; k++) g.lineTo(s[3 * face[k]], s[3 * face[k] + 1]);
    }
    g.closePath();
    g.fillStyle = style;
    g.fill();
    g.lineWidth = (body.smooth ? 0.6 : 0.8) * ratio;
    g.strokeStyle = body.smooth ? style : colors.edge;
    g.stroke();
  }
}

// ------------------------------------------------------------------------------------------- full meshes

const STILL = 300;  // after which a picture counts as still [ms]
const glass = document.createElement("canvas");  // WebGL draws a robot here, and the picture takes it from here
const wanted = data.models.some(model => model.full);
let gl = wanted ? glass.getContext("webgl2", { failIfMajorPerformanceCaveat: true }) : null, pen = null;
const slow = wanted && !gl;  // without a graphics processor: still pictures alone are drawn in full
if (slow) gl = glass.getContext("webgl2");
const moving = () => state.playing || performance.now() - state.touched < STILL;
glass.addEventListener("webglcontextlost", () => { gl = null; state.dirty = true; });

const VERTEX = `#version 300 es
in vec3 where; in vec3 outward;
uniform vec3 low, size, place, eye, right, up, back; uniform mat3 turn; uniform vec3 lens;  // two scales and near
out vec3 point, normal;
void main() {
  point = turn * (low + size * where) + place;
  normal = turn * outward;
  vec3 q = point - eye;
  float depth = -dot(back, q), n = lens.z, f = 4000.0 * n;
  gl_Position = vec4(lens.x * dot(right, q), lens.y * dot(up, q), (depth * (f + n) - 2.0 * f * n) / (f - n), depth);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 point, normal;
uniform vec3 eye, color; uniform float level, above;
out vec4 seen;
void main() {
  if (above * (point.z - level) < 0.0) discard;
  vec3 n = normalize(normal);
  n = dot(n, eye - point) < 0.0 ? -n : n;
  seen = vec4(min(color * (0.73 + 0.31 * dot(n, vec3(0.29, -0.42, 0.86))), 1.0), 1.0);
}`;

function program() {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.bindAttribLocation(made, 0, "where");
  gl.bindAttribLocation(made, 1, "outward");
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) return null;  // then simplified meshes are drawn
  const names = ["low", "size", "place", "eye", "right", "up", "back", "turn", "lens", "color", "level", "above"];
  return { made, at: Object.fromEntries(names.map(name => [name, gl.getUniformLocation(made, name)])) };
}

async function unpack(full) {  // as packed by view/full_mesh.py: vertices of six short numbers, and corners
  const packed = Uint8Array.from(atob(full.data), c => c.charCodeAt(0));
  const flow = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(flow).arrayBuffer());
  const count = full.pieces.reduce((n, piece) => n + piece.points, 0), corners = full.pieces.reduce((n, piece) => n + 3 * piece.triangles, 0);
  const vertices = new Int16Array(6 * count), steps = new Uint16Array(vertices.buffer), order = new Uint32Array(corners);
  let at = 0, first = 0, begin = 0;
  for (const piece of full.pieces) {
    const n = piece.points, m = 3 * piece.triangles, sum = new Float32Array(3 * n);
    for (let k = 0; k < 3; k++) for (let i = 0, x = 0; i < n; i++) {
      x += bytes[at + k * n + i] | bytes[at + (3 + k) * n + i] << 8;
      steps[6 * (first + i) + k] = x;
    }
    at += 6 * n;
    for (let i = 0, x = 0; i < m; i++) {
      x += bytes[at + i] | bytes[at + m + i] << 8 | bytes[at + 2 * m + i] << 16 | bytes[at + 3 * m + i] << 24;
      order[begin + i] = first + x;
    }
    at += 4 * m;
    const p = (i, k) => piece.size[k] * steps[6 * i + k];
    for (let i = begin; i < begin + m; i += 3) {  // normals of triangles, by their areas
      const [a, b, c] = [order[i], order[i + 1], order[i + 2]];
      const ux = p(b, 0) - p(a, 0), uy = p(b, 1) - p(a, 1), uz = p(b, 2) - p(a, 2);
      const vx = p(c, 0) - p(a, 0), vy = p(c, 1) - p(a, 1), vz = p(c, 2) - p(a, 2);
      for (const j of [a, b, c]) {
        const o = 3 * (j - first);
        sum[o] += uy * vz - uz * vy; sum[o + 1] += uz * vx - ux * vz; sum[o + 2] += ux * vy - uy * vx;
      }
    }
    for (let i = 0; i < n; i++) {
      const length = Math.hypot(sum[3 * i], sum[3 * i + 1], sum[3 * i + 2]) || 1;
      for (let k = 0; k < 3; k++) vertices[6 * (first + i) + 3 + k] = 32767 * sum[3 * i + k] / length;
    }
    Object.assign(piece, { begin, pale: gray(piece.color) });
    first += n; begin += m;
  }
  return { vertices, order };
}

async function prepare(model) {
  const { vertices, order } = await unpack(model.full);
  pen = pen || program();
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.STATIC_DRAW);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, order, gl.STATIC_DRAW);
  gl.enableVertexAttribArray(0);
  gl.enableVertexAttribArray(1);
  gl.vertexAttribPointer(0, 3, gl.UNSIGNED_SHORT, true, 12, 0);
  gl.vertexAttribPointer(1, 3, gl.SHORT, true, 12, 6);
  model.array = pen && array;
  state.dirty = true;
}

function fullRobot(g, cam, model, at, { tint, pale }, level, above) {
  if (glass.width !== cam.w || glass.height !== cam.h) { glass.width = cam.w; glass.height = cam.h; }
  const u = pen.at;
  gl.viewport(0, 0, cam.w, cam.h);
  gl.clearColor(0, 0, 0, 0);
  gl.enable(gl.DEPTH_TEST);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.useProgram(pen.made);
  gl.bindVertexArray(model.array);
  for (const name of ["eye", "right", "up", "back"]) gl.uniform3fv(u[name], cam[name]);
  gl.uniform3f(u.lens, 2 * cam.focus / cam.w, 2 * cam.focus / cam.h, cam.near);
  gl.uniform1f(u.level, level);
  gl.uniform1f(u.above, above);
  for (const piece of model.full.pieces) {
    const p = at[piece.body], color = tint && tint(piece.body) || (pale ? piece.pale : piece.color);
    gl.uniform3fv(u.low, piece.low);
    gl.uniform3fv(u.size, piece.size);
    gl.uniform3f(u.place, p[0], p[1], p[2]);
    gl.uniformMatrix3fv(u.turn, true, p.slice(3));
    gl.uniform3f(u.color, color[0] / 255, color[1] / 255, color[2] / 255);
    gl.drawElements(gl.TRIANGLES, 3 * piece.triangles, gl.UNSIGNED_INT, 4 * piece.begin);
  }
  g.drawImage(glass, 0, 0);
}

const veil = document.createElement("canvas");
function ghost(g, cam, model, at, how) {  // drawn apart and laid over the picture as a whole
  veil.width = cam.w;
  veil.height = cam.h;
  robot(veil.getContext("2d"), cam, model, at, how);
  g.globalAlpha = 0.4;
  g.drawImage(veil, 0, 0);
  g.globalAlpha = 1;
}

// ------------------------------------------------------------------------------------------- forces and footprints

function outline(points) {  // hull of [x, y, z] as seen from above
  const p = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]), hull = [];
  const turn = (a, b, c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
  for (const way of [p, [...p].reverse()]) {
    const chain = [];
    for (const x of way) {
      while (chain.length > 1 && turn(chain.at(-2), chain.at(-1), x) <= 0) chain.pop();
      chain.push(x);
    }
    hull.push(...chain.slice(0, -1));
  }
  return hull;
}

function pushes(run, t) {  // of other bodies, at the nearest frame: whose points these are changes with time
  if (!run.pairs) return [];
  const [k, m, f] = place(run, t), p = run.pairs[f < 0.5 ? k : m], out = [];
  for (let i = 0; i < p.length; i += 6) {
    out.push({ at: p.slice(i, i + 3).map(x => x * data.unit), force: p.slice(i + 3, i + 6).map(x => 1e-3 * x) });
  }
  return out;
}

function contacts(run, t) {  // [{at, force [weights], touches}]
  if (!run.points) return [];
  const [k, m, f] = place(run, t), x = mixed(run.points[k], run.points[m], f, data.unit), out = [];
  const F = run.forces && mixed(run.forces[k], run.forces[m], f, 1e-3);
  for (let i = 0; i < x.length / 3; i++) {
    const force = F ? F.slice(3 * i, 3 * i + 3) : null;
    out.push({ at: x.slice(3 * i, 3 * i + 3), force, touches: F ? Math.hypot(...force) > 5e-3 : Boolean(run.touch[k][i]) });
  }
  return out;
}

function lines(g, cam, run) {  // that are painted on the ground
  g.beginPath();
  for (const p of run.lines) trace(g, cam.clipped([0, 3, 6, 9].map(i => p.slice(i, i + 3))));
  g.fillStyle = colors.paint;
  g.fill("nonzero");
}

function rays(g, cam, run, t, ratio) {  // of range sensors, with a dot where they end
  const [k, m, f] = place(run, t), meets = run.rays[f < 0.5 ? k : m], x = mixed(run.rays[k], run.rays[m], f, data.unit);
  g.strokeStyle = g.fillStyle = colors.ray;
  g.lineWidth = 1.2 * ratio;
  for (let i = 0; i < x.length; i += 7) {
    const a = cam.see(x.slice(i, i + 3)), b = cam.see(x.slice(i + 3, i + 6));
    if (a[2] < cam.near || b[2] < cam.near) continue;
    g.globalAlpha = meets[i + 6] ? 0.6 : 0.25;
    g.beginPath();
    g.moveTo(a[0], a[1]);
    g.lineTo(b[0], b[1]);
    g.stroke();
    g.globalAlpha = 1;
    if (!meets[i + 6]) continue;
    g.beginPath();
    g.arc(b[0], b[1], 2.2 * ratio, 0, 2 * Math.PI);
    g.fill();
  }
}

function prints(g, cam, run, t, ratio) {
  g.lineWidth = 1.2 * ratio;
  for (const { at, color, points: p } of run.prints) {
    if (at > t) break;
    const points = [];
    for (let i = 0; i < p.length; i += 3) points.push([p[i] * data.unit, p[i + 1] * data.unit, p[i + 2] * data.unit]);
    g.beginPath();
    trace(g, cam.clipped(outline(points)));
    g.fillStyle = "rgba(" + color + ",0.25)";
    g.strokeStyle = "rgb(" + color + ")";
    g.fill();
    g.stroke();
  }
}

function support(g, cam, touching) {
  g.beginPath();
  trace(g, cam.clipped(outline(touching.map(c => c.at))));
  g.fillStyle = colors.support;
  g.fill();
}

function arrows(g, cam, touching, ratio, onGround) {
  g.lineWidth = 2 * ratio;
  g.strokeStyle = g.fillStyle = colors.force;
  const total = [0, 0, 0, 0];
  for (const { at, force } of touching) {
    if (!force) continue;
    const a = cam.see(at), b = cam.see(at.map((x, k) => x + ARROW * data.span * force[k]));
    const weight = Math.max(0, force[2]);
    at.forEach((x, k) => { total[k] += weight * x; });
    total[3] += weight;
    if (a[2] < cam.near || b[2] < cam.near) continue;
    const dx = b[0] - a[0], dy = b[1] - a[1], length = Math.hypot(dx, dy);
    if (length < 1) continue;
    const head = Math.min(9 * ratio, length), ux = dx / length, uy = dy / length;
    g.beginPath();
    g.moveTo(a[0], a[1]);
    g.lineTo(b[0] - 0.7 * head * ux, b[1] - 0.7 * head * uy);
    g.stroke();
    g.beginPath();
    trace(g, [b, [b[0] - head * ux + 0.4 * head * uy, b[1] - head * uy - 0.4 * head * ux], [b[0] - head * ux - 0.4 * head * uy, b[1] - head * uy + 0.4 * head * ux]]);
    g.fill();
  }
  if (onGround && total[3] > 0.01) {  // center of pressure
    const c = cam.see([0, 1, 2].map(k => total[k] / total[3]));
    g.beginPath();
    g.arc(c[0], c[1], 5 * ratio, 0, 2 * Math.PI);
    g.fillStyle = colors.page;
    g.fill();
    g.strokeStyle = colors.pressure;
    g.stroke();
    g.beginPath();
    g.arc(c[0], c[1], 2 * ratio, 0, 2 * Math.PI);
    g.fillStyle = colors.pressure;
    g.fill();
  }
}

// ------------------------------------------------------------------------------------------- pictures

function text(element, words) { if (element.textContent !== words) element.textContent = words; }
function short(x) { return Math.abs(x) >= 100 ? x.toFixed(0) : Math.abs(x) >= 1 ? x.toFixed(2) : Math.abs(x) < 1e-12 ? "0" : x.toPrecision(2); }
const ended = (run, t) => run.failed && t >= run.end - 1e-9;
const statusText = run => run.failed ? run.status + " at " + short(run.end) + " s" : run.status;

function told(runs) {  // whose states are told in one line
  const all = new Map();
  runs.forEach((run, k) => {
    const key = data.together && runs.length > FEW ? run.status + statusText(run) + run.message : k;
    all.set(key, [...(all.get(key) || []), run]);
  });
  return [...all.values()].map(alike => ({
    of: alike.length > FEW ? alike.length + " bodies" : alike.map(run => run.caption).join(", "), run: alike[0], alike,
  }));
}

function panel(runs) {
  const figure = document.createElement("figure"), caption = document.createElement("figcaption");
  const groups = told(runs);
  for (const { of, run } of groups) {
    const line = document.createElement("div"), status = document.createElement("span");
    line.append(of + " ");
    status.className = "status " + (run.status === "ok" ? "ok" : "bad");
    status.textContent = statusText(run);
    if (run.times.length > 1 || run.status !== "ok") line.append(status);
    if (run.message) {
      const message = document.createElement("span");
      message.className = "message";
      message.textContent = message.title = run.message;
      line.append(message);
    }
    caption.append(line);
  }
  const canvas = document.createElement("canvas"), now = document.createElement("div");
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "moving picture of " + groups.map(({ of, run, alike }) => (alike.length > 1 ? of : models[run.model].name + ", " + of) + ": " + statusText(run)).join("; "));
  now.className = "now";
  new ResizeObserver(fit).observe(now);  // its words may need another line
  figure.append(caption, canvas, now);
  steer(canvas);
  return { runs, figure, canvas, now };
}

let panels = [];
function arrange() {
  const groups = shown.ghosts || data.together ? [data.runs] : data.runs.map(run => [run]);
  panels = groups.map(panel);
  $("views").replaceChildren(...panels.map(p => p.figure));
  fit();
}

function fit() {  // pictures get what the window leaves, so that the controls are seen
  const beside = panels.length > 1 && $("views").clientWidth >= 2 * (innerHeight <= 500 ? 200 : 300) + 8;
  const rows = beside ? Math.ceil(panels.length / Math.floor($("views").clientWidth / (innerHeight <= 500 ? 208 : 308))) : panels.length;
  const around = $("views").getBoundingClientRect().top + scrollY + $("controls").offsetHeight + 10;
  const rest = Math.max(...panels.map(p => p.figure.offsetHeight - p.canvas.offsetHeight)) + 8;
  const plots = innerHeight > 640 && data.plots.length ? 196 : 0;
  const half = rows > 1 || data.live ? 0 : innerHeight / 2;  // of the window at least is the picture
  for (const { canvas } of panels) {
    const room = Math.max((innerHeight - around - plots) / rows - rest, half);
    const height = data.report ? 0.66 * canvas.clientWidth : Math.min((innerWidth <= 600 ? 1.2 : 0.8) * canvas.clientWidth, room);
    canvas.style.height = Math.round(Math.max(110, height)) + "px";
  }
  plotLayers();
  state.dirty = true;
}

function center(run, at) {
  const base = at[run.root], first = run.home || run.frames[0], i = 7 * run.root, m = run.middle;
  const moved = shown.follow && FOLLOWS && models[run.model].moves;
  const away = k => moved ? base[k] - data.unit * first[i + k] : 0;
  return [m[0] + away(0) + view.pan[0], m[1] + away(1) + view.pan[1], m[2] + (run.floor.quads ? away(2) : 0) + view.pan[2]];
}

function drawPanel({ runs, canvas, now }) {
  const ratio = window.devicePixelRatio || 1;
  const w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const g = canvas.getContext("2d", { alpha: false }), t = state.time, main = lead(runs);
  const at = runs.map(run => poses(run, Math.min(t, run.end))), cam = camera(w, h, center(main, at[runs.indexOf(main)]));
  g.fillStyle = colors.sky;
  g.fillRect(0, 0, w, h);
  ground(g, cam, main.floor);
  lines(g, cam, main);
  runs.forEach((run, k) => {
    if (shown.prints) prints(g, cam, run, Math.min(t, run.end), ratio);
    shadow(g, cam, models[run.model].bodies, at[k], run.floor);
  });
  const order = runs.map((_, k) => k).reverse();
  const depth = k => cam.see(at[k][runs[k].root])[2];
  if (data.together) order.sort((a, b) => depth(b) - depth(a));  // far ones first
  const how = run => ({ tint: shown.load && run.load ? loads(run, models[run.model], t) : null, pale: ended(run, t), ratio });
  const side = main.level === null ? 0 : cam.eye[2] >= main.level ? 1 : -1;  // of the surface of a fluid, where the eye is
  if (side) {
    for (const k of order) if (!k || data.together) robot(g, cam, models[runs[k].model], at[k], how(runs[k]), main.level, -side);
    water(g, cam, main.level);
  }
  for (const k of order) {
    const run = runs[k], model = models[run.model];
    const touching = contacts(run, Math.min(t, run.end)).filter(c => c.touches);
    if (shown.prints && run.feet) support(g, cam, touching);
    if (k && !data.together) ghost(g, cam, model, at[k], how(run));
    else robot(g, cam, model, at[k], how(run), main.level, side);
    if (shown.forces) {
      arrows(g, cam, touching, ratio, true);
      arrows(g, cam, pushes(run, Math.min(t, run.end)), ratio, false);
    }
    if (shown.rays && run.rays) rays(g, cam, run, Math.min(t, run.end), ratio);
  }
  hands.pull(g, cam, ratio);
  const failed = runs.filter(run => ended(run, t));
  if (failed.length) stamp(g, told(failed).map(({ of, run }) => (runs.length > 1 ? of + ": " : "") + statusText(run)).join("; "), w, ratio);
  const loaded = runs.find(run => run.load);
  if (shown.load && loaded) legend(g, w, h, ratio, loaded.load.of);
  text(now, (data.together && walks(main) ? main.caption + ": " : "") + readout(main, at[runs.indexOf(main)], t));
}

function loads(run, model, t) {
  const [k] = place(run, Math.min(t, run.end)), percent = run.load.percent[k], of = {};
  model.joints.forEach((joint, j) => { if (joint.body >= 0) of[joint.body] = Math.max(of[joint.body] || 0, percent[j]); });
  return body => loadColor(of[body] || 0);
}

function stamp(g, words, w, ratio) {
  g.font = "600 " + 15 * ratio + "px system-ui, sans-serif";
  const width = Math.min(w - 8 * ratio, g.measureText(words).width + 20 * ratio);
  g.fillStyle = colors.badpage;
  g.fillRect((w - width) / 2, 8 * ratio, width, 26 * ratio);
  g.fillStyle = colors.bad;
  g.textAlign = "center";
  g.fillText(words, w / 2, 26 * ratio, width - 8 * ratio);
  g.textAlign = "left";
}

function legend(g, w, h, ratio, of) {
  const n = 40, width = Math.min(160 * ratio, 0.4 * w), x = 10 * ratio, y = h - 16 * ratio;
  for (let k = 0; k < n; k++) {
    g.fillStyle = "rgb(" + loadColor(100 * k / n) + ")";
    g.fillRect(x + k * width / n, y, width / n + 1, 8 * ratio);
  }
  g.font = 12 * ratio + "px system-ui, sans-serif";
  g.fillStyle = colors.text;
  g.fillText("torque, 0 to 100 % of " + of, x, y - 5 * ratio);
}

function readout(run, at, t) {
  const words = [], [k, m, f] = place(run, Math.min(t, run.end));
  if (data.together ? walks(run) : models[run.model].moves) {
    const way = at[run.root][0] - data.unit * (run.home || run.frames[0])[7 * run.root];
    words.push((Math.round(1e3 * way) || 0) + " mm ahead");
  }
  if (run.energy) words.push((run.energy[k] + f * (run.energy[m] - run.energy[k])).toFixed(1) + " J drawn");
  const since = words.length ? "since the start: " + words.join(", ") : "";
  const grid = run.floor.quads ? "" : "squares of " + (square() < 1 ? 1e3 * square() + " mm" : square() + " m");
  return [...hands.words(since), grid, run.floor.real ? "" : "no ground in this run"].filter(Boolean).join("; ");
}

// ------------------------------------------------------------------------------------------- plots

const plots = [];
const offered = [...new Set(data.runs.flatMap(run => Object.keys(run.channels)))];

function addPlot(name) {
  const figure = document.createElement("figure"), row = document.createElement("div"), canvas = document.createElement("canvas");
  const channel = document.createElement("select"), column = document.createElement("select"), close = document.createElement("button");
  figure.className = "plot";
  row.className = "row";
  channel.setAttribute("aria-label", "channel");
  column.setAttribute("aria-label", "which of it");
  close.textContent = "×";
  close.setAttribute("aria-label", "remove this plot");
  canvas.setAttribute("role", "img");
  channel.append(...offered.map(x => new Option(x, x)));
  channel.value = name;
  row.append(channel, column, close);
  figure.append(row, canvas);
  const plot = { name, column: -1, figure, canvas, layer: document.createElement("canvas"), box: null };
  const columns = () => {
    const labels = data.runs.find(run => run.channels[plot.name]).channels[plot.name].labels;
    column.replaceChildren(new Option("all", -1), ...labels.map((label, k) => new Option(label, k)));
    column.hidden = labels.length < 2;
    canvas.setAttribute("aria-label", "plot of " + plot.name + " over time");
  };
  channel.onchange = () => { plot.name = channel.value; plot.column = -1; columns(); layer(plot); };
  column.onchange = () => { plot.column = Number(column.value); layer(plot); };
  close.onclick = () => { plots.splice(plots.indexOf(plot), 1); figure.remove(); state.dirty = true; };
  const seek = event => { if (plot.box && event.buttons) { const b = plot.box; go(start + (end - start) * (event.offsetX - b.x) / b.w); } };
  canvas.onpointerdown = event => { canvas.setPointerCapture(event.pointerId); seek(event); };
  canvas.onpointermove = seek;
  columns();
  plots.push(plot);
  $("more-plots").before(figure);
  layer(plot);
}

function plotLayers() { plots.forEach(layer); }

function lineColor(channel, k, several) {
  if (channel.labels.length <= 8 || several) return colors.lines[k % colors.lines.length];
  return colors[channel.sides[k] || "mid"];
}

function ticks(low, high, most) {
  const raw = (high - low) / most, ten = 10 ** Math.floor(Math.log10(raw)), step = ten * [1, 2, 5, 10].find(k => k * ten >= raw), out = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) out.push(k * step);
  return [out, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
}

function layer(plot) {  // all that does not move
  const ratio = window.devicePixelRatio || 1, canvas = plot.layer, width = plot.canvas.clientWidth, height = plot.canvas.clientHeight;
  plot.canvas.width = canvas.width = Math.round(width * ratio);
  plot.canvas.height = canvas.height = Math.round(height * ratio);
  state.dirty = true;
  if (!width) return;
  const g = canvas.getContext("2d");
  g.scale(ratio, ratio);
  g.font = "11px system-ui, sans-serif";
  const lines = [], alone = data.runs.length === 1;
  data.runs.forEach((run, r) => {
    const c = run.channels[plot.name];
    if (c) c.labels.forEach((label, k) => {
      if (plot.column < 0 || plot.column === k) lines.push({ run, r, c, k, label: data.together ? run.caption + "/" + label : plot.column < 0 || alone ? label : run.caption.split(":")[0],
        color: lineColor(c, plot.column < 0 ? k : r, plot.column >= 0), range: 0 });
    });
  });
  let low = Infinity, high = -Infinity;
  for (const line of lines) {
    let a = Infinity, b = -Infinity;
    for (const v of line.c.values[line.k]) { a = Math.min(a, v); b = Math.max(b, v); }
    low = Math.min(low, a * line.c.scale); high = Math.max(high, b * line.c.scale);
    line.range = (b - a) * line.c.scale;
  }
  if (!(high > low)) { low -= 0.5 * Math.abs(low) || 1; high += 0.5 * Math.abs(high) || 1; }
  const room = 0.05 * (high - low);
  low -= room; high += room;
  const right = width < 500 ? 100 : 150, box = { x: 48, y: 16, w: width - 48 - right, h: height - 36 };
  const X = t => box.x + box.w * (t - start) / (end - start || 1), Y = v => box.y + box.h * (high - v) / (high - low);
  Object.assign(plot, { box, lines, X, Y });
  const [vertical, digits] = ticks(low, high, 4), [across, places] = ticks(start, end > start ? end : start + 1, Math.max(2, box.w / 70));
  g.strokeStyle = colors.grid;
  g.lineWidth = 1;
  g.fillStyle = colors.soft;
  g.textAlign = "right";
  for (const v of vertical) {
    g.beginPath(); g.moveTo(box.x, Y(v)); g.lineTo(box.x + box.w, Y(v)); g.stroke();
    g.fillText(v.toFixed(digits).length > 7 ? v.toExponential(0) : v.toFixed(digits), box.x - 4, Y(v) + 4);
  }
  g.textAlign = "center";
  for (const t of across) {
    g.beginPath(); g.moveTo(X(t), box.y); g.lineTo(X(t), box.y + box.h); g.stroke();
    g.fillText(t.toFixed(places), X(t), box.y + box.h + 13);
  }
  g.textAlign = "left";
  g.fillText("s", box.x + box.w + 12, box.y + box.h + 13);
  g.fillText((lines[0] ? plot.name + " [" + lines[0].c.unit + "]" : ""), box.x, 11);
  for (const run of data.runs) if (run.failed) {
    g.fillStyle = colors.bad;
    g.setLineDash([3, 3]); g.strokeStyle = colors.bad;
    g.beginPath(); g.moveTo(X(run.end), box.y); g.lineTo(X(run.end), box.y + box.h); g.stroke();
    g.setLineDash([]);
    const late = X(run.end) > box.x + 0.6 * box.w;
    g.textAlign = late ? "right" : "left";
    g.fillText((alone ? "" : run.caption.split(":")[0] + " ") + statusText(run), X(run.end) + (late ? -4 : 4), box.y + 10);
    g.textAlign = "left";
  }
  g.lineWidth = lines.length > 8 ? 1 : 1.5;
  g.save();
  g.beginPath(); g.rect(box.x, box.y - 2, box.w, box.h + 4); g.clip();
  for (const { r, c, k, color } of lines) {
    g.beginPath();
    c.values[k].forEach((v, i) => i ? g.lineTo(X(c.times[i]), Y(v * c.scale)) : g.moveTo(X(c.times[i]), Y(v * c.scale)));
    g.strokeStyle = color;
    g.setLineDash(r && plot.column < 0 ? [5, 3] : []);
    g.stroke();
  }
  g.restore();
}

function valueAt({ c, k, run }) {
  const t = Math.min(state.time, run.end), [i, j, f] = place(c, t), v = c.values[k];
  return c.scale * (v[i] + f * (v[j] - v[i]));
}

function drawPlot(plot) {
  if (!plot.box) return;
  const ratio = window.devicePixelRatio || 1, g = plot.canvas.getContext("2d"), { box, X, Y } = plot;
  g.setTransform(1, 0, 0, 1, 0, 0);
  g.clearRect(0, 0, plot.canvas.width, plot.canvas.height);
  if (plot.layer.width) g.drawImage(plot.layer, 0, 0);
  g.scale(ratio, ratio);
  g.strokeStyle = colors.text;
  g.lineWidth = 1;
  g.beginPath(); g.moveTo(X(state.time), box.y); g.lineTo(X(state.time), box.y + box.h); g.stroke();
  const fits = Math.floor((box.h + 14) / 12), most = [...plot.lines].sort((a, b) => b.range - a.range).slice(0, fits);
  const labels = most.map(line => ({ line, value: valueAt(line) })).map(x => ({ ...x, y: Y(x.value) })).sort((a, b) => a.y - b.y);
  const top = box.y, bottom = box.y + box.h + 2;  // labels at the height of their values, moved apart
  labels.forEach((label, k) => { label.at = Math.max(label.y, k ? labels[k - 1].at + 12 : top); });
  for (let k = labels.length - 1, last = bottom; k >= 0; k--) { labels[k].at = Math.min(labels[k].at, last); last = labels[k].at - 12; }
  g.font = (box.w < 250 ? "10px" : "11px") + " system-ui, sans-serif";
  for (const { line, value, y, at } of labels) {
    g.fillStyle = line.color;
    g.beginPath(); g.arc(X(Math.min(state.time, line.run.end)), y, 2.5, 0, 2 * Math.PI); g.fill();
    const dashed = line.r && plot.column < 0 ? "- " : "";
    g.fillText(dashed + line.label.replaceAll("_", " ") + " " + short(value), box.x + box.w + 6, at + 3, plot.canvas.clientWidth - box.x - box.w - 8);
  }
}

// ------------------------------------------------------------------------------------------- reports

function made(tag, kind, ...inner) {  // an element; texts among what it holds are no markup
  const element = document.createElement(tag);
  if (kind) element.className = kind;
  element.append(...inner);
  return element;
}

function prose({ text, soft }) {  // **bold**, `code`
  const words = text.split(/(\*\*[^*]+\*\*|`[^`]+`)/);
  return made("p", soft ? "soft" : "", ...words.map(w => w.startsWith("**") ? made("b", "", w.slice(2, -2)) : w[0] === "`" ? made("code", "", w.slice(1, -1)) : w));
}

function table({ head, rows }) {
  const cell = (tag, scope) => content => {
    const { text, mark, small, link } = content.text === undefined ? { text: content } : content;
    const element = made(tag, "", link ? Object.assign(made("a", "", text), { href: link }) : text);
    if (scope) element.scope = scope;
    if (mark) element.append(made("span", ...mark));
    if (small) element.append(made("small", "", small));
    return element;
  };
  const line = ([first, ...rest]) => made("tr", "", cell("th", "row")(first), ...rest.map(cell("td")));
  return made("table", "", made("thead", "", made("tr", "", ...head.map(cell("th", "col")))), made("tbody", "", ...rows.map(line)));
}

const W = 420, LEFT = 40, RIGHT = 12, FOOT = 32;  // of a chart, and its margins
const safe = words => words.replace(/[&<>"]/g, c => "&#" + c.charCodeAt() + ";");
const label = (x, y, words, anchor) => `<text x="${x}" y="${y}" text-anchor="${anchor || "start"}">${safe(String(words))}</text>`;
const line = (kind, x1, y1, x2, y2) => `<line class="${kind}" x1="${x1}" y1="${y1}" x2="${x2}" y2="${y2}"/>`;
const round = (low, most) => ticks(low, most, 6)[0].map(t => Number(t.toPrecision(6)));

const CHARTS = {
  intervals({ rows }) {  // 5th to 95th percentile and median, a bar each
    const most = 1.08 * Math.max(...rows.map(row => row[3])), height = 44 * rows.length + FOOT, x = v => LEFT + (W - LEFT - RIGHT) * v / most;
    const grid = round(most / 1e6, most).map(t => label(x(t), height - 12, t, "middle") + line("axis", x(t), 6, x(t), height - FOOT + 4));
    return [height, ...grid, ...rows.map(([name, low, middle, high], k) => {
      const y = 44 * k + 30, kind = name === "found" ? " found" : "";
      return label(LEFT, y - 10, name) + line("range" + kind, x(low), y, x(high), y) + `<circle class="mid${kind}" cx="${x(middle)}" cy="${y}" r="6"/>`;
    })];
  },
  search({ at, costs, best, since }) {  // each candidate, and the lowest so far
    const height = 220, n = at.at(-1), most = 1.15 * best.find(f => f !== null), seen = f => f !== null && f <= most;
    const along = c => LEFT + (W - LEFT - RIGHT) * c / n, x = k => along(at[k]), y = f => 8 + (height - FOOT - 8) * (1 - f / most), parts = [];
    for (const t of round(0, most)) parts.push(label(LEFT - 6, y(t) + 4, t, "end"), line("axis", LEFT, y(t), W - RIGHT, y(t)));
    for (const t of round(0, n)) parts.push(label(along(t), height - 12, t, "middle"));
    costs.forEach((f, k) => { if (seen(f)) parts.push(`<circle class="dot" cx="${x(k).toFixed(1)}" cy="${y(f).toFixed(1)}" r="1.6"/>`); });
    if (since !== null) {
      const early = x(since) < 0.6 * W;
      parts.push(label(x(since) + (early ? 4 : -4), 20, "with limits", early ? "start" : "end"), line("first", x(since), 8, x(since), height - FOOT));
    }
    const points = best.map((f, k) => seen(f) ? x(k).toFixed(1) + "," + y(f).toFixed(1) : "").filter(Boolean);
    return [height, ...parts, `<polyline class="best" points="${points.join(" ")}"/>`];
  },
};

CHARTS.histogram = ({ edges, counts, median, x: along, y: up }) => {  // counts of what lies between edges, and the median
  const height = 230, foot = height - FOOT - 14, [low, high] = [edges[0], edges.at(-1)], most = 1.05 * Math.max(...counts);
  const x = v => LEFT + (W - LEFT - RIGHT) * (v - low) / (high - low || 1), y = n => 22 + (foot - 22) * (1 - n / most), parts = [];
  const whole = ticks(0, most, 5)[0].filter(Number.isInteger);
  for (const t of whole) parts.push(label(LEFT - 6, y(t) + 4, t, "end"), line("axis", LEFT, y(t), W - RIGHT, y(t)));
  for (const t of round(low, high)) parts.push(label(x(t), foot + 16, t, "middle"), line("axis", x(t), foot, x(t), foot + 4));
  counts.forEach((n, k) => parts.push(`<rect class="bar" x="${x(edges[k]).toFixed(1)}" y="${y(n).toFixed(1)}" width="${(x(edges[k + 1]) - x(edges[k])).toFixed(1)}" height="${(foot - y(n)).toFixed(1)}"/>`));
  const late = x(median) > 0.6 * W;
  parts.push(line("median", x(median), 10, x(median), foot), label(x(median) + (late ? -5 : 5), 18, "median " + Number(median.toPrecision(3)), late ? "end" : "start"));
  return [height, ...parts, label(LEFT - 6, 14, up, "middle"), label((LEFT + W - RIGHT) / 2, height - 6, along, "middle")];
};

function chart(part) {
  const [height, ...drawn] = CHARTS[part.chart](part), box = made("div", "", made("p", "soft", part.what));
  box.insertAdjacentHTML("beforeend", `<svg viewBox="0 0 ${W} ${height}" role="img" aria-label="${safe(part.what)}">${drawn.join("")}</svg>`);
  return box;
}

function report({ lead, tiles, sections }) {
  document.body.classList.add("reports");
  const parts = section => section.parts.map(part => part.chart ? chart(part) : part.head ? table(part) : prose(part));
  const first = [
    made("p", "soft", lead),
    made("div", "tiles", ...tiles.map(([name, value, note]) => made("div", "tile", made("span", "soft", name), made("b", "", value), made("small", "", note))))];
  if (data.runs.length) $("views").before(...first); else $("report").append(...first);
  $("report").append(...sections.map(section => made("section", "", made("h2", "", section.title), ...parts(section))));
}

// ------------------------------------------------------------------------------------------- time

function go(t) { state.time = Math.min(end, Math.max(start, t)); state.playing = false; touch(); }
function play() { if (!state.playing && state.time >= end) state.time = start; state.playing = !state.playing; state.dirty = true; }
function frameStep(n) {
  const times = data.runs.reduce((a, run) => run.times.length > a.length ? run.times : a, []);
  const k = times.findIndex(t => t > state.time + 1e-9), here = k < 0 ? times.length - 1 : k - 1;
  const off = here >= 0 && n < 0 && times[here] < state.time - 1e-9 ? 1 : 0;
  go(times[Math.min(times.length - 1, Math.max(0, here + n + off))]);
}

function show() {
  const begun = state.drawn = performance.now();
  panels.forEach(drawPanel);
  plots.forEach(drawPlot);
  $("time").value = state.time;
  $("time").setAttribute("aria-valuetext", state.time.toFixed(2) + " seconds");
  if (!data.live) text($("clock"), state.time.toFixed(end - start < 1 ? 3 : 2) + " s");
  text($("play"), state.playing ? "Pause" : "Play");
  frames.push(performance.now() - begun);
  if (frames.length > KEPT) frames.shift();
}

let last = null;
function tick(now) {
  if (state.playing && last !== null) {
    state.time += Number($("rate").value) * Math.min(0.25, (now - last) / 1000);
    if (state.time > end) state.time = end > start ? start : end;
    state.dirty = true;
  }
  last = now;
  if (slow && state.touched > state.drawn - STILL && !moving()) state.dirty = true;
  if (state.dirty) { state.dirty = false; show(); }
  requestAnimationFrame(tick);
}

// ------------------------------------------------------------------------------------------- hands

const PRESETS = { corner: [-1.1, 0.3], side: [-Math.PI / 2, 0.02], front: [0, 0.05], top: [-Math.PI / 2, 1.55] };
function preset(name) {
  if (!PRESETS[name]) return;
  [view.yaw, view.pitch] = PRESETS[name];
  Object.assign(view, { span: data.span, pan: [0, 0, 0] });
  state.dirty = true;
}
function touch() { state.touched = performance.now(); state.dirty = true; }
function turn(right, up) { view.yaw -= right; view.pitch = Math.min(1.55, Math.max(0, view.pitch + up)); touch(); }
function zoom(factor) { view.span = Math.min(200 * data.span, Math.max(0.05 * data.span, view.span * factor)); touch(); }
function move(canvas, dx, dy) {
  const cam = camera(canvas.clientWidth, canvas.clientHeight, [0, 0, 0]);
  view.pan = view.pan.map((x, k) => x + (cam.up[k] * dy - cam.right[k] * dx) / cam.pixels);
  touch();
}
function rate(by) { const s = $("rate"); s.selectedIndex = Math.min(s.length - 1, Math.max(0, s.selectedIndex - by)); state.dirty = true; }

function steer(canvas) {
  const down = new Map();
  const gap = () => { const [a, b] = [...down.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
  canvas.onpointerdown = event => {
    canvas.setPointerCapture(event.pointerId);
    if (!hands.grab(canvas, event)) down.set(event.pointerId, [event.clientX, event.clientY]);
  };
  canvas.onpointerup = canvas.onpointercancel = canvas.onlostpointercapture = event => { hands.drop(event); down.delete(event.pointerId); };
  canvas.onpointermove = event => {
    if (hands.drag(event)) return;
    const before = down.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before[0], dy = event.clientY - before[1], apart = down.size === 2 ? gap() : 0;
    down.set(event.pointerId, [event.clientX, event.clientY]);
    if (down.size === 2) { if (apart > 0) zoom(apart / Math.max(1, gap())); move(canvas, dx / 2, dy / 2); }
    else if (event.shiftKey || event.buttons & 2) move(canvas, dx, dy);
    else turn(0.01 * dx, 0.01 * dy);
  };
  canvas.oncontextmenu = event => event.preventDefault();
  canvas.onwheel = event => { event.preventDefault(); zoom(Math.exp(0.001 * event.deltaY)); };
}

const TOGGLES = [["follow", "C", "follow", FOLLOWS && data.models.some(m => m.moves)], ["forces", "F", "forces", data.runs.some(r => r.forces || r.pairs)],
  ["prints", "P", "footprints", data.runs.some(r => r.feet)], ["rays", "R", "rays", data.runs.some(r => r.rays)], ["load", "L", "load", data.runs.some(r => r.load)],
  ["meshes", "M", "full meshes", gl], ["ghosts", "G", "ghosts", data.runs.length > 1 && !data.together]].filter(toggle => toggle[3]);
const buttons = {};
function toggle(name) {
  if (!buttons[name]) return;
  shown[name] = !shown[name];
  buttons[name].setAttribute("aria-pressed", shown[name]);
  if (name === "ghosts") arrange();
  state.dirty = true;
}
for (const [name, key, words] of TOGGLES) {
  const button = buttons[name] = document.createElement("button");
  button.textContent = words;
  button.title = words + " (" + key + ")";
  button.setAttribute("aria-pressed", shown[name]);
  button.onclick = () => toggle(name);
  $("toggles").append(button);
}

function help() { const d = $("help"); if (d.open) d.close(); else d.showModal(); }
if (data.runs.length) document.addEventListener("keydown", event => {
  const tag = event.target.tagName, key = event.key, sky = tag === "CANVAS" && event.target.tabIndex === 0;
  if (event.ctrlKey || event.metaKey || event.altKey || tag === "SELECT" || (tag === "BUTTON" && (key === " " || key === "Enter"))) return;
  const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1], a: [-0.1, 0], d: [0.1, 0], w: [0, 0.1], s: [0, -0.1] };
  const does = {
    " ": play, k: play, ArrowLeft: () => frameStep(event.shiftKey ? -10 : -1), ArrowRight: () => frameStep(event.shiftKey ? 10 : 1),
    ",": () => frameStep(-1), ".": () => frameStep(1), Home: () => go(start), End: () => go(end), "[": () => rate(-1), "]": () => rate(1),
    1: () => preset("corner"), 2: () => preset("side"), 3: () => preset("front"), 4: () => preset("top"),
    "+": () => zoom(0.85), "=": () => zoom(0.85), "-": () => zoom(1 / 0.85), c: () => toggle("follow"), f: () => toggle("forces"),
    p: () => toggle("prints"), r: () => toggle("rays"), l: () => toggle("load"), m: () => toggle("meshes"), g: () => toggle("ghosts"), "?": help,
  };
  const turned = turns[key.length > 1 ? key : key.toLowerCase()];
  const act = turned && (sky || key.length === 1) ? () => turn(...turned) : does[key.length > 1 ? key : key.toLowerCase()];
  if (act) { event.preventDefault(); act(); }
});

$("play").onclick = play;
$("back").onclick = () => frameStep(-1);
$("ahead").onclick = () => frameStep(1);
$("closer").onclick = () => zoom(0.85);
$("farther").onclick = () => zoom(1 / 0.85);
$("keys").onclick = help;
$("preset").onchange = event => { preset(event.target.value); event.target.value = ""; };
$("time").min = start;
$("time").max = end;
$("time").oninput = event => go(Number(event.target.value));

// ------------------------------------------------------------------------------------------- beginning

if (offered.length) {
  const more = document.createElement("div"), button = document.createElement("button");
  more.id = "more-plots";
  button.textContent = "+ plot";
  button.onclick = () => addPlot(offered.find(name => !plots.some(plot => plot.name === name)) || offered[0]);
  more.append(button);
  $("plots").append(more);
}
if (end === start) for (const element of document.querySelectorAll("#controls .row:first-child, #rate")) element.hidden = true;
$("notes").textContent = data.notes.join("; ");
readColors();
const asked = new URLSearchParams(location.hash.slice(1));  // page.html#t=1.5&view=side stops there and looks so
preset(asked.get("view"));
if (asked.has("t") && Number.isFinite(Number(asked.get("t")))) go(Number(asked.get("t")));
if (data.report) report(data.report);
$("controls").hidden = !data.runs.length;
if (gl) models.filter(model => model.full).forEach(model => prepare(model).catch(error => console.warn("full meshes: " + error)));
if (data.runs.length) {
  arrange();
  data.plots.forEach(addPlot);
  fit();
  window.addEventListener("resize", fit);
  media("(prefers-color-scheme: dark)").addEventListener("change", () => { readColors(); plotLayers(); state.dirty = true; });
  requestAnimationFrame(tick);
}
window.viewer = { data, ready: () => models.every(model => !model.full || model.array), view, shown, state, frames, plots, show, go, preset };
