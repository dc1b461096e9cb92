// A robot that is driven by keys, and pulled at by a pointer: what is added to page.js for it.
// The server, view/drive.py, sends poses as events, and is sent what is held.

const BEAT = 100;           // between two messages while something is held [ms]
const held = new Set(), live = { grab: null, force: null, lost: 0, ended: "", sent: -Infinity, number: Date.now(), source: null };
const keyOf = event => event.key.length === 1 ? event.key.toLowerCase() : event.key;

function ray(cam, canvas, x, y) {  // from the eye through a pixel
  const px = (x - canvas.clientWidth / 2) / canvas.clientWidth * cam.w / cam.focus, py = (canvas.clientHeight / 2 - y) / canvas.clientHeight * cam.h / cam.focus;
  return [0, 1, 2].map(k => px * cam.right[k] + py * cam.up[k] - cam.back[k]);
}

function hit(o, d, model, at) {  // the nearest body that a ray meets, and where in its axes
  let best = null, near = Infinity;
  model.bodies.forEach((body, b) => {
    const p = at[b], e = [o[0] - p[0], o[1] - p[1], o[2] - p[2]], x = body.points;
    const turn = v => [0, 1, 2].map(k => p[3 + k] * v[0] + p[6 + k] * v[1] + p[9 + k] * v[2]);
    const [ox, oy, oz] = turn(e), [dx, dy, dz] = turn(d);
    for (const face of body.faces) for (let k = 2; k < face.length; k++) {  // T. Moeller and B. Trumbore (1997)
      const [a, m, n] = [3 * face[0], 3 * face[k - 1], 3 * face[k]];
      const ux = x[m] - x[a], uy = x[m + 1] - x[a + 1], uz = x[m + 2] - x[a + 2], vx = x[n] - x[a], vy = x[n + 1] - x[a + 1], vz = x[n + 2] - x[a + 2];
      const cx = dy * vz - dz * vy, cy = dz * vx - dx * vz, cz = dx * vy - dy * vx, det = ux * cx + uy * cy + uz * cz;
      if (Math.abs(det) < 1e-15) continue;
      const tx = ox - x[a], ty = oy - x[a + 1], tz = oz - x[a + 2], u = (tx * cx + ty * cy + tz * cz) / det;
      if (u < 0 || u > 1) continue;
      const qx = ty * uz - tz * uy, qy = tz * ux - tx * uz, qz = tx * uy - ty * ux, v = (dx * qx + dy * qy + dz * qz) / det;
      const t = (vx * qx + vy * qy + vz * qz) / det;
      if (v < 0 || u + v > 1 || t <= 0 || t >= near) continue;
      near = t;
      best = { body: b, point: [ox + t * dx, oy + t * dy, oz + t * dz] };
    }
  });
  return best && { ...best, near };
}

const world = (p, x) => [0, 1, 2].map(k => p[k] + p[3 + 3 * k] * x[0] + p[4 + 3 * k] * x[1] + p[5 + 3 * k] * x[2]);
function seenFrom(canvas) {
  const main = lead(panels.find(panel => panel.canvas === canvas).runs);
  const ratio = window.devicePixelRatio || 1;
  return camera(canvas.clientWidth * ratio, canvas.clientHeight * ratio, center(main, poses(main, state.time)));
}

function grab(canvas, event) {  // what the pointer meets is pulled from now on
  if (!data.live || !data.live.limit || live.ended || live.grab || event.shiftKey || event.button > 0) return false;
  const cam = seenFrom(canvas), d = ray(cam, canvas, event.offsetX, event.offsetY);
  let found = null;
  data.runs.forEach((run, r) => {
    const one = run.home && hit(cam.eye, d, models[run.model], poses(run, state.time));
    if (one && (!found || one.near < found.near)) found = { ...one, run: r };
  });
  if (!found) return false;
  live.grab = { ...found, canvas, pointer: event.pointerId, x: event.offsetX, y: event.offsetY };
  send();
  return true;
}
function drag(event) {
  if (!live.grab || live.grab.pointer !== event.pointerId) return false;
  Object.assign(live.grab, { x: event.offsetX, y: event.offsetY });
  return true;
}
function drop(event) { if (live.grab && (!event || live.grab.pointer === event.pointerId)) { live.grab = null; send(); } }
function target() {  // where the pointer is in the plane through the grabbed point that faces the camera
  const { canvas, run, body, point, x, y } = live.grab, cam = seenFrom(canvas), d = ray(cam, canvas, x, y);
  const at = world(poses(data.runs[run], state.time)[body], point);
  const depth = -[0, 1, 2].reduce((s, k) => s + cam.back[k] * (at[k] - cam.eye[k]), 0);
  return { at, target: [0, 1, 2].map(k => cam.eye[k] + depth * d[k]) };
}

function send(more = {}) {
  live.sent = performance.now();
  live.number += 1;
  const found = live.grab && { run: live.grab.run, body: live.grab.body, point: live.grab.point, target: target().target };
  const body = JSON.stringify({ n: live.number, keys: [...held], grab: found, ...more });
  if (more.closing) navigator.sendBeacon("input", body);
  else fetch("input", { method: "POST", body, keepalive: true }).catch(() => {});
}
function release(closing) { if (held.size || live.grab) { held.clear(); live.grab = null; marks(); send({ closing }); } }
function press(key, on) {
  if (!data.live.keys.includes(key) || on === held.has(key)) return;
  if (on) held.add(key); else held.delete(key);
  marks();
  send();
}
function marks() { for (const button of document.querySelectorAll("#drive [data-key]")) button.setAttribute("aria-pressed", held.has(button.dataset.key)); }

function pull(g, cam, ratio) {  // the force on the grabbed point, and the pointer
  if (live.grab) {
    const { at, target: to } = target(), a = cam.see(at), b = cam.see(to);
    g.strokeStyle = colors.pressure;
    g.lineWidth = 1.2 * ratio;
    g.setLineDash([4 * ratio, 4 * ratio]);
    g.beginPath(); g.moveTo(a[0], a[1]); g.lineTo(b[0], b[1]); g.stroke();
    g.setLineDash([]);
    g.beginPath(); g.arc(a[0], a[1], 4 * ratio, 0, 2 * Math.PI); g.fillStyle = colors.pressure; g.fill();
  }
  if (!live.force) return;
  const at = live.force.slice(0, 3), force = live.force.slice(3), size = Math.hypot(...force);
  arrows(g, cam, [{ at, force: force.map(x => x / data.live.limit) }], ratio, false);
  const tip = cam.see(at.map((x, k) => x + ARROW * data.span * force[k] / data.live.limit)), words = size.toPrecision(3) + " N";
  g.font = "600 " + 13 * ratio + "px system-ui, sans-serif";
  const wide = g.measureText(words).width + 8 * ratio, x = Math.min(Math.max(tip[0] + 8 * ratio, 0), cam.w - wide), y = Math.min(Math.max(tip[1], 20 * ratio), cam.h - 8 * ratio);
  g.fillStyle = colors.page;
  g.fillRect(x, y - 15 * ratio, wide, 20 * ratio);
  g.fillStyle = colors.force;
  g.fillText(words, x + 4 * ratio, y);
}

function news(event) {
  const frame = JSON.parse(event.data);
  frame.frames.forEach((numbers, k) => { if (numbers) Object.assign(data.runs[k], { frames: [numbers], times: [frame.t], end: frame.t }); });
  Object.assign(live, { force: frame.force, lost: frame.lost, ended: frame.ended });
  state.time = frame.t;
  state.touched = performance.now();
  state.dirty = true;
  text($("clock"), frame.t.toFixed(2) + " s");
  if (!frame.ended) return;
  held.clear(); live.grab = null; marks();
  live.source.close();
  for (const button of document.querySelectorAll("#drive button")) button.disabled = true;
}

const ARROWS = { ArrowUp: "↑", ArrowDown: "↓", ArrowLeft: "←", ArrowRight: "→", " ": "space" };
function beginLive() {
  const row = $("drive");
  for (const key of data.live.keys) {
    const button = made("button", "", ARROWS[key] || key);
    button.dataset.key = key;
    button.setAttribute("aria-label", "hold " + (key === " " ? "space" : key));
    button.onpointerdown = event => { button.setPointerCapture(event.pointerId); press(key, true); };
    button.onpointerup = button.onpointercancel = button.onlostpointercapture = () => press(key, false);
    button.oncontextmenu = event => event.preventDefault();
    row.append(button);
  }
  const stop = made("button", "", "End");
  stop.title = "end the run and store it";
  stop.onclick = () => send({ end: true });
  row.append($("clock"), stop);
  row.hidden = false;
  document.addEventListener("keydown", event => {
    const key = keyOf(event);
    if (event.ctrlKey || event.metaKey || event.altKey || !data.live.keys.includes(key) || live.ended) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) press(key, true);
  }, true);
  document.addEventListener("keyup", event => press(keyOf(event), false), true);
  window.addEventListener("blur", () => release());
  document.addEventListener("visibilitychange", () => { if (document.hidden) release(); });
  window.addEventListener("pagehide", () => release(true));
  data.runs.forEach(run => { if (models[run.model].bodies.length) run.home = run.frames[0]; });
  live.source = new EventSource("events");
  live.source.onmessage = news;
  setInterval(() => { if ((held.size || live.grab) && performance.now() - live.sent > (live.grab ? 30 : BEAT)) send(); }, 15);
}

const lost = () => live.lost >= 0.01 ? live.lost.toFixed(2) + " s of real time lost" : "";
Object.assign(hands, { grab, drag, drop, pull, words: since => [live.ended, since, lost()] });
window.viewer.live = live;
beginLive();
fit();  // the picture leaves room for the keys
