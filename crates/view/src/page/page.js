// The live page: draws received snapshots and sends commands. It uses no library and connects only to its own server.
"use strict";

const PHASES = ["needs reset", "resetting", "in place", "running", "at goal", "aborted", "finished", "waiting"];
const HEADER = 16, ROBOT = 9, LINK = 6, MOVER = 4, SCAN = 12, UNKNOWN = -32768, NO_ECHO = 65535;
const STALE_MS = 700;      // Snapshot age [ms] at which the page turns grey; checked every 100 ms, so within 1 s.
const TRAIL_MS = 150, TRAIL_LENGTH = 30;
const MANY = 500;          // Number of links above which they are drawn thin and without dashes.
const MANY_GOALS = 30;     // Number of goals above which they have no numbers and no lines.
const BINS = 20, BIN_MS = 25;
const SILENT = 75;         // Encoded age of a robot, in 20 ms, above which its agent is missing.
const RATES = [0.1, 0.25, 0.5, 1, 2, 5, 10];
const JUMP_MS = 1500;      // Of the record: a longer step in its time is a jump, after which trails begin anew.
const $ = id => document.getElementById(id);
const canvas = $("canvas"), pen = canvas.getContext("2d");

let scene = null, goals = [], status = null, holder = false;
let world = null, links = null, heardAt = -Infinity, dirty = true, stale = true;
let chosen = null, colours = {}, trails = [], trailAt = 0, view = { k: 1, x: 0, y: 0 };
let histogram = new Float32Array(BINS + 1);
let dragging = false, wanted = null; // The rate of a record that was chosen here and is not reported back yet.
const counts = { bytes: 0, snapshots: 0, drawn: 0, drawMs: 0 };

// ---- WebSockets

// The token is in the address of the first load. It is removed from there, and kept for reloads of this tab.
const given = location.hash.slice(1);
if (given) { sessionStorage.setItem("token", given); history.replaceState(null, "", location.pathname); }
const token = sessionStorage.getItem("token") || "";
const protocols = /^[0-9a-f]+$/.test(token) ? ["murmurate", "token." + token] : ["murmurate"];
let control = null, stopWanted = false, refusedUntil = 0;
let barred = false; // The server has let this page in to nothing: there is no token, or a wrong one.

function connect(path, open, message) {
  const socket = new WebSocket(`ws://${location.host}/${path}`, protocols);
  let opened = false;
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { opened = true; barred = false; open(socket); };
  socket.onmessage = event => message(event.data);
  socket.onclose = () => {
    if (path === "control") { control = null; barred = !opened && heardAt < 0 && status === null; }
    setTimeout(connect, 500, path, open, message);
  };
}

connect("view", () => {}, data => {
  counts.bytes += data.byteLength;
  if (data.byteLength < HEADER) return;
  const before = world && world.getUint32(4, true);
  world = new DataView(data);
  const passed = world.getUint32(4, true) - before;
  if (passed < 0 || scene && scene.record && passed > JUMP_MS) { trails = []; histogram.fill(0); }
  showTime();
  links = readLinks(world);
  heardAt = performance.now();
  counts.snapshots++;
  dirty = true;
  if (stale) checkStale();
});

connect("control", socket => { control = socket; if (stopWanted) send({ do: "stop" }); }, data => {
  counts.bytes += data.length;
  const { kind, body } = JSON.parse(data);
  if (kind === "hello") { holder = body.holder; wanted = null; }
  if (kind === "scene") { scene = body; setUp(); }
  if (kind === "goals") { goals = body.goals; dirty = true; }
  if (kind === "status") { status = body; showStatus(); }
  if (kind === "refused") { wanted = null; refusedUntil = performance.now() + 4000; notice(`Refused: ${body.why}`); }
});

function send(command) {
  if (control && control.readyState === WebSocket.OPEN) { control.send(JSON.stringify(command)); return true; }
  notice("Not sent: there is no connection to the program.");
  return false;
}

function stop() {
  stopWanted = true;
  if (!send({ do: "stop" })) {
    notice("STOP is not sent: no connection. It is sent once there is one; " +
      "use 'murmurate stop' or the robots' switch.");
  }
}

function notice(text, kind = "alarm") {
  $("notice").textContent = text;
  $("notice").className = kind;
  $("notice").hidden = !text;
}

// ---- set-up

function setUp() {
  document.title = `${scene.scenario}, ${scene.robots} robots – Murmurate`;
  world = null; trails = []; goals = []; logLines.clear();
  $("log").replaceChildren();
  reachWalls();
  $("rows").replaceChildren(...Array.from({ length: scene.robots }, (_, robot) => row(robot)));
  $("faults").hidden = scene.control !== "emulation";
  setUpRecord();
  $("link").replaceChildren(...scene.links.map(name => new Option(name)));
  const names = Array.from({ length: scene.robots }, (_, robot) => new Option(`robot ${robot}`, robot));
  $("robot").replaceChildren(...names);
  $("ages").hidden = !scene.hears_links;
  // Lines that are not drawn are not explained.
  for (const id of ["show-links", "colour"]) $(id).closest("label").hidden = !scene.hears_links;
  document.querySelector(".legend").hidden = !scene.hears_links;
  $("show-scans").closest("label").hidden = scene.scans.length === 0;
  for (const id of ["link", "cut", "delay", "loss"]) $(id).closest(".row").hidden = scene.links.length === 0;
  $("histogram").replaceChildren(...Array.from({ length: BINS + 1 }, () => document.createElement("div")));
  const margin = scene.hull_m + 0.15, half = scene.half_extent;
  canvas.style.setProperty("--aspect", `${half[0] + margin} / ${half[1] + margin}`);
  dirty = true;
}

// Why links are not shown: a record may say it.
function unheard() { return scene.record && scene.record.note || "links between robots are not heard here"; }
// The ground is drawn up to where hulls reach, since centres stay within it. A wall that ends at its edge, or beyond,
// ends where the drawn ground does.
function reachWalls() {
  const edge = scene.half_extent.map(half => half + scene.hull_m);
  const to = (at, axis) => Math.abs(at) >= scene.half_extent[axis] - 1e-3 ? Math.sign(at) * edge[axis] : at;
  const reach = walls => walls.map(wall => Array.isArray(wall) ? wall.map((at, k) => to(at, k % 2)) : wall);
  scene.walls = reach(scene.walls);
  scene.drawn = scene.drawn.map(reach);
}

// Obstacles may be drawn for each episode; the state server's instructions say which one it is.
function wallsNow() { return status && scene.drawn[status.episode - 1] || scene.walls; }

// A record has no team to stop: the scrubber takes the place of the orders.
function setUpRecord() {
  const record = scene.record;
  for (const id of ["stop", "confirmed-of"]) $(id).hidden = !!record;
  document.querySelector(".orders").hidden = !!record;
  $("scrubber").hidden = !record;
  if (!record) return;
  $("seek").max = record.duration_s;
  $("rate").replaceChildren(...RATES.map(rate => new Option(`${rate}×`, rate, rate === 1, rate === 1)));
  $("marks").replaceChildren(...record.marks.map(mark => {
    const button = document.createElement("button");
    button.className = mark.kind;
    button.tabIndex = -1;
    button.title = `${mark.at_s.toFixed(2)} s: ${mark.text}`;
    button.style.left = `${100 * mark.at_s / Math.max(record.duration_s, 1e-9)}%`;
    button.onclick = () => seek(mark.at_s);
    return button;
  }));
}

function row(robot) {
  const row = document.createElement("tr"), name = document.createElement("button");
  name.textContent = robot;
  name.setAttribute("aria-label", `links of robot ${robot}`);
  for (let cell = 0; cell < 8; cell++) row.insertCell();
  row.cells[0].append(name);
  row.onclick = () => choose(robot === chosen ? null : robot);
  return row;
}

function choose(robot) {
  if (chosen !== null) $("rows").rows[chosen]?.removeAttribute("aria-selected");
  chosen = robot;
  if (chosen !== null) $("rows").rows[chosen].setAttribute("aria-selected", "true");
  dirty = true;
  showLinks();
}

// ---- status as text

function set(node, text) { if (node.textContent !== text) node.textContent = text; }

function showStatus() {
  const s = status;
  const standing = s.pause === "yes" && s.latch === "clear";
  const words = { clear: standing ? "paused" : "running", held: "HELD", stopped: "STOPPED" };
  if (s.playback) {
    words.clear = s.playback.playing ? "playing" : "halted";
    set($("play"), s.playback.playing ? "Halt" : "Play");
    // A status on its way while a rate is chosen still has the old one, which the next order would send again.
    if (wanted === s.playback.rate) wanted = null;
    if (wanted === null && document.activeElement !== $("rate")) $("rate").value = s.playback.rate;
    for (const id of ["play", "step", "step-back", "mark-on", "mark-back", "seek", "rate"]) $(id).disabled = !holder;
  }
  if (s.latch === "stopped") stopWanted = false;
  const finished = s.phase === 6 && s.latch === "clear";
  if (!stale) {
    set($("state"), s.over ? "over" : finished ? "finished" : words[s.latch]);
    $("state").dataset.is = s.over ? "stale" : standing ? "held" : s.latch;
  }
  set($("confirmed"), `${s.confirmed}/${s.robots}`);
  $("confirmed").className = s.confirmed < s.robots && s.latch !== "clear" ? "bad" : "";
  set($("episode"), s.episode === null ? "–" : `${s.episode}${scene && scene.episodes ? "/" + scene.episodes : ""}`);
  set($("phase"), s.phase === null ? "–" : PHASES[s.phase] + (s.pause === "asked" ? ", then pause" : ""));
  const percent = share => (100 * share).toFixed(0);
  const of = s.success;
  set($("success"), !of ? "not heard here" : !of.episodes ? "–" : `${of.successes} of ${of.episodes} (95 %: ` +
    `${percent(of.interval[0])} to ${percent(of.interval[1])} %)`);
  $("success").title = Object.entries(s.verdicts).map(([verdict, times]) => `${verdict}: ${times}`).join(", ");
  set($("clock"), `${s.time_s.toFixed(1)} s` + (s.speed === null ? "" : `, ${s.speed.toFixed(1)}×`));
  const may = holder && scene && scene.control !== "stop";
  $("rearm").disabled = !may || s.latch !== "stopped" || s.ordering;
  $("resume").disabled = !may || !(s.latch === "held" || s.pause !== "no");
  $("pause").disabled = !may || s.latch !== "clear" || s.pause !== "no";
  set($("killed"), s.killed.length ? `down: ${s.killed.join(", ")}` : "");
  showMesh();
  showRows();
  showLog();
  showLinks();
  showAges();
}

// Who hears whom, whom the state server has lost, and how hosts send, as hosts report it.
function showMesh() {
  const mesh = status.mesh;
  $("mesh").hidden = !mesh;
  $("show-hears").closest("label").hidden = !mesh;
  if (!mesh) return;
  dirty = true;
  const farthest = Math.max(0, ...mesh.hops.map(one => one.hops));
  set($("mesh-to"), mesh.hops.length ? `(up to ${farthest} ${farthest === 1 ? "hop" : "hops"} to ${mesh.to})` : "(no hops)");
  const line = (id, text) => { $(id).hidden = !text; set($(id), text); };
  line("mesh-lost", mesh.lost.length ? `the state server has lost robots ${mesh.lost.join(", ")}` : "");
  line("mesh-withholding", mesh.withholding.length ? `passing nothing on: ${mesh.withholding.join(", ")}` : "");
  $("mesh-sends").replaceChildren(...mesh.sends.map(({ host, how, why }) => {
    const item = document.createElement("li"), because = document.createElement("small");
    because.textContent = why;
    item.append(`${host}: ${how} `, because);
    return item;
  }));
}

// Pairs of robots of which the first hears the second directly: "1,2" and the share lost [%].
function heardPairs() { return new Map(status.mesh.hears.map(([at, other, loss]) => [`${at},${other}`, loss])); }

function recordTime() { return world ? world.getUint32(4, true) / 1000 : 0; }

function showTime() {
  if (!scene || !scene.record) return;
  const now = recordTime();
  if (!dragging) $("seek").value = now;
  set($("seek-text"), `${now.toFixed(2)} of ${scene.record.duration_s.toFixed(2)} s`);
}

function showRows() {
  if (!scene || !world) return;
  const n = world.getUint16(2, true), s = status, table = $("rows").rows;
  const late = new Map(s.late), battery = new Map(s.battery), flight = new Map(s.flight), worst = worstAges(n);
  const oldest = new Map(s.link), down = new Set(s.down);
  const guard = new Map(s.guard.map(([robot, name, age]) => [robot, guardText(name, age)]));
  const hops = new Map((s.mesh ? s.mesh.hops : []).map(one => [one.robot, one])), lost = new Set(s.mesh ? s.mesh.lost : []);
  const noHops = hops.size === 0 && lost.size === 0;
  $("hops-head").hidden = noHops;
  const noBattery = battery.size === 0;
  $("battery-head").hidden = noBattery;
  for (let robot = 0; robot < Math.min(n, table.length); robot++) {
    const at = HEADER + robot * ROBOT, phase = world.getUint8(at + 6), age = world.getUint8(at + 7);
    const cells = table[robot].cells;
    // A robot whose agent is not heard stands, whatever it said last.
    const gone = down.has(robot) ? "process died" : age > SILENT && age < 255 && s.phase !== 6 ? "missing" : "";
    const said = phase === 255 ? "–" : PHASES[phase], flies = flight.get(robot);
    // A robot that flies is where it has to be; the column has no room for what is so all the time.
    set(cells[1], gone || (flies && flies !== "flying" ? `${said}, ${flies}` : said));
    cells[1].className = gone ? "bad" : "";
    set(cells[2], age === 255 ? "never" : age === 250 ? "> 5 s" : `${(age / 50).toFixed(2)} s`);
    cells[2].className = age > SILENT ? "bad" : "";
    const link = worst[robot];
    // Where links are not known, a robot's own host may have reported the age of its oldest one [ms].
    const told = scene.hears_links ? undefined : oldest.get(robot);
    set(cells[3], told !== undefined ? `${(told / 1000).toFixed(2)} s` : !scene.hears_links || link < 0 ? "–" :
      link === 255 ? "never" : link === 250 ? "> 2.5 s" : `${(link / 100).toFixed(2)} s`);
    cells[3].className = (told === undefined ? link > 50 : told > 500) ? "bad" : "";
    // A process that does not receive the guards' counts shows a dash and not 0.
    set(cells[4], late.has(robot) ? String(late.get(robot)) : scene.hears_links ? "0" : "–");
    const over = hops.get(robot);
    cells[5].hidden = noBattery;
    set(cells[5], battery.has(robot) ? `${battery.get(robot)} %` : "–");
    set(cells[6], guard.get(robot) || "–");
    cells[6].title = guard.get(robot) || "";
    cells[7].hidden = noHops;
    set(cells[7], lost.has(robot) ? "lost" : over ? `${over.at_least ? "≥ " : ""}${over.hops}` : "–");
    cells[7].className = lost.has(robot) ? "bad" : "";
    cells[7].title = over ? `${over.age_s.toFixed(1)} s ago` : "";
  }
}

function guardText(name, age) {
  return age === null || age < 5 ? name : `${name}, ${age.toFixed(0)} s ago`;
}

// Decodes a snapshot's links: robots at both ends, ages and losses, as arrays.
function readLinks(snapshot) {
  const n = snapshot.getUint16(2, true), m = snapshot.getUint16(8, true), base = HEADER + n * ROBOT;
  const [words, bytes] = [() => new Uint16Array(m), () => new Uint8Array(m)];
  const links = { m, one: words(), other: words(), age: bytes(), loss: bytes() };
  for (let link = 0, at = base; link < m; link++, at += LINK) {
    links.one[link] = snapshot.getUint16(at, true);
    links.other[link] = snapshot.getUint16(at + 2, true);
    links.age[link] = snapshot.getUint8(at + 4);
    links.loss[link] = snapshot.getUint8(at + 5);
  }
  return links;
}

function worstAges(n) {
  const worst = new Int16Array(n).fill(-1);
  const { m, one, other, age } = links;
  for (let link = 0; link < m; link++) {
    if (age[link] > worst[one[link]]) worst[one[link]] = age[link];
    if (age[link] > worst[other[link]]) worst[other[link]] = age[link];
  }
  return worst;
}

function showLinks() {
  const place = $("links-of");
  place.hidden = chosen === null || !world;
  if (place.hidden) return;
  const lines = [];
  for (let link = 0; link < links.m; link++) {
    const one = links.one[link], other = links.other[link], age = links.age[link], loss = links.loss[link];
    if (one !== chosen && other !== chosen) continue;
    const item = document.createElement("li");
    const old = age === 255 ? "never" : `${(age / 100).toFixed(2)} s`;
    item.textContent = `${one === chosen ? other : one}: ${old}${loss === 255 ? "" : `, ${loss} % lost`}`;
    if (age > 50) item.className = "bad";
    lines.push(item);
  }
  if (status && status.mesh && !lines.length) return showHeard(place);
  const title = document.createElement("h2"), list = document.createElement("ul");
  title.textContent = !scene.hears_links ? `robot ${chosen}: ${unheard()}` :
    `links of robot ${chosen}: ${lines.length || "no robot in range"}`;
  list.append(...lines);
  place.replaceChildren(title, list);
}

// Whom the chosen robot hears directly, and who hears it.
function showHeard(place) {
  const lists = [["hears", at => [chosen, at]], ["is heard by", at => [at, chosen]]];
  const pairs = heardPairs(), nodes = [];
  for (const [verb, pair] of lists) {
    const title = document.createElement("h2"), list = document.createElement("ul");
    for (let other = 0; other < status.robots; other++) {
      const loss = pairs.get(pair(other).join());
      if (loss === undefined) continue;
      const item = document.createElement("li");
      item.textContent = `${other}: ${loss} % lost`;
      if (loss > 30) item.className = "bad";
      list.append(item);
    }
    title.textContent = `robot ${chosen} ${verb}${list.children.length ? "" : ": nobody"}`;
    nodes.push(title, list);
  }
  place.replaceChildren(...nodes);
}

function showAges() {
  if (!world || !scene || !scene.hears_links) return;
  let total = 0;
  histogram = histogram.map(times => times * 0.8);
  for (const age of links.age) {
    histogram[age === 255 ? BINS : Math.min(BINS, Math.floor(age * 10 / BIN_MS))]++;
  }
  for (const times of histogram) total += times;
  const most = Math.max(...histogram, 1e-9), bars = $("histogram").children;
  let sum = 0, half = null;
  for (let bin = 0; bin <= BINS; bin++) {
    sum += histogram[bin];
    if (half === null && total && sum >= total / 2) half = bin;
    bars[bin].style.height = `${100 * histogram[bin] / most}%`;
    bars[bin].className = bin < 100 / BIN_MS ? "fresh" : bin < 300 / BIN_MS ? "old" : "late";
  }
  const median = half === null ? "no links" : half >= BINS ? "half are older than 0.5 s" :
    `half within ${((half + 1) * BIN_MS / 1000).toFixed(3)} s`;
  set($("ages-text"), `(${median})`);
}

// A line that changes, as one of a guard that acts again and again, replaces itself and moves to the top.
let logged = 0;
const logLines = new Map();
function showLog() {
  const last = status.log.length ? status.log[status.log.length - 1].number : 0;
  if (last < logged) { logged = 0; logLines.clear(); $("log").replaceChildren(); }
  for (const { number, id, time_s, text } of status.log) {
    if (number <= logged) continue;
    const line = document.createElement("li"), at = document.createElement("time");
    at.textContent = `${time_s.toFixed(1)} s`;
    line.append(at, " " + text);
    if (logLines.has(id)) logLines.get(id).remove();
    logLines.set(id, line);
    $("log").prepend(line);
    logged = number;
  }
  while ($("log").children.length > 200) $("log").lastChild.remove();
}

// ---- picture

function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["ground", "wall", "robot", "done", "hit", "halted", "silent", "on-robot", "goal", "trail",
    "fresh", "old", "late", "none", "line", "accent", "dim", "nose"]) {
    colours[name] = style.getPropertyValue("--" + name).trim();
  }
  dirty = true;
}

function positions(snapshot, n) {
  const at = new Float32Array(2 * n);
  for (let robot = 0; robot < n; robot++) {
    const from = HEADER + robot * ROBOT, x = snapshot.getInt16(from, true), y = snapshot.getInt16(from + 2, true);
    at[2 * robot] = x === UNKNOWN ? NaN : x * scene.scale_m;
    at[2 * robot + 1] = y === UNKNOWN ? NaN : y * scene.scale_m;
  }
  return at;
}

function fit() {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const margin = scene.hull_m + 0.15;
  view.k = Math.min(w / (2 * (scene.half_extent[0] + margin)), h / (2 * (scene.half_extent[1] + margin)));
  view.x = w / 2;
  view.y = h / 2;
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.clearRect(0, 0, w, h);
  pen.setTransform(view.k, 0, 0, -view.k, view.x, view.y);
  return ratio / view.k; // Length of one CSS pixel [m].
}

function draw() {
  requestAnimationFrame(draw);
  if (!dirty || !scene) return;
  dirty = false;
  const began = performance.now(), pixel = fit(), hull = Math.max(scene.hull_m, 3 * pixel);
  const edge = scene.half_extent.map(half => half + scene.hull_m);
  pen.fillStyle = colours.ground;
  pen.fillRect(-edge[0], -edge[1], 2 * edge[0], 2 * edge[1]);
  pen.lineWidth = pixel; pen.strokeStyle = colours.line;
  pen.strokeRect(-edge[0], -edge[1], 2 * edge[0], 2 * edge[1]);
  pen.fillStyle = colours.wall;
  wallsNow().forEach(drawWall);
  if (!world) return;
  drawMovers();
  const n = world.getUint16(2, true), at = positions(world, n);
  keepTrail(at);
  if ($("show-range").checked && scene.range_m) drawRange(at, n, pixel);
  if ($("show-links").checked) drawLinks(at, pixel);
  if ($("show-hears").checked && status && status.mesh) drawHeard(at, pixel);
  if ($("show-trails").checked) drawTrails(n, pixel);
  if ($("show-goals").checked) drawGoals(at, hull, pixel);
  if ($("show-scans").checked) drawScans(pixel);
  drawRobots(at, n, hull, pixel);
  counts.drawMs += performance.now() - began;
  counts.drawn++;
  window.murmurate.view = { ...view };
}

// A wall is a rectangle along the axes, [x, y, x, y], a disc or a polygon.
function drawWall(wall) {
  if (Array.isArray(wall)) return pen.fillRect(wall[0], wall[1], wall[2] - wall[0], wall[3] - wall[1]);
  pen.beginPath();
  if (wall.disc) pen.arc(...wall.disc, 0, 2 * Math.PI);
  else for (const corner of wall.polygon) pen.lineTo(...corner);
  pen.fill();
}

// Offset of the places of moving obstacles in a snapshot.
function moversAt() { return HEADER + world.getUint16(2, true) * ROBOT + world.getUint16(8, true) * LINK; }

// Draws the moving obstacles where they are. Between episodes there are none.
function drawMovers() {
  for (let mover = 0, from = moversAt(); mover < world.getUint16(14, true); mover++, from += MOVER) {
    pen.save();
    pen.translate(world.getInt16(from, true) * scene.scale_m, world.getInt16(from + 2, true) * scene.scale_m);
    drawWall(scene.movers[mover].body);
    pen.restore();
  }
}

function keepTrail(at) {
  const now = performance.now();
  if (trails.length && trails[0].length !== at.length) trails = [];
  if (now - trailAt < TRAIL_MS) return;
  trailAt = now;
  trails.push(at);
  if (trails.length > TRAIL_LENGTH) trails.shift();
}

function drawRange(at, n, pixel) {
  pen.strokeStyle = colours.accent; pen.globalAlpha = chosen === null && n > 30 ? 0.15 : 0.35; pen.lineWidth = pixel;
  pen.beginPath();
  for (let robot = 0; robot < n; robot++) {
    if (chosen !== null && robot !== chosen) continue;
    const x = at[2 * robot], y = at[2 * robot + 1];
    pen.moveTo(x + scene.range_m, y);
    pen.arc(x, y, scene.range_m, 0, 2 * Math.PI);
  }
  pen.stroke();
  pen.globalAlpha = 1;
}

function drawLinks(at, pixel) {
  const byLoss = $("colour").value === "loss", names = ["fresh", "old", "late", "none"];
  const paths = names.map(() => []);
  for (let link = 0; link < links.m; link++) {
    const one = links.one[link], other = links.other[link], age = links.age[link], loss = links.loss[link];
    if (chosen !== null && one !== chosen && other !== chosen) continue;
    const kind = age === 255 ? 3 : byLoss ? (loss <= 5 ? 0 : loss <= 30 ? 1 : 2) : age <= 10 ? 0 : age <= 30 ? 1 : 2;
    paths[kind].push(one, other);
  }
  pen.globalAlpha = at.length > 400 ? 0.45 : 0.75;
  for (let kind = 3; kind >= 0; kind--) {
    pen.strokeStyle = colours[names[kind]];
    pen.lineWidth = (kind === 3 || links.m > MANY ? 1 : 1.6) * pixel;
    // Dashing thousands of lines would take most of a frame's time.
    pen.setLineDash(kind === 3 && links.m <= MANY ? [4 * pixel, 4 * pixel] : []);
    pen.beginPath();
    const path = paths[kind];
    for (let end = 0; end < path.length; end += 2) {
      pen.moveTo(at[2 * path[end]], at[2 * path[end] + 1]);
      pen.lineTo(at[2 * path[end + 1]], at[2 * path[end + 1] + 1]);
    }
    pen.stroke();
  }
  pen.setLineDash([]);
  pen.globalAlpha = 1;
}

// Draws who hears whom directly, by the worse loss: a line where both do, a dashed one where one alone does.
function drawHeard(at, pixel) {
  const pairs = heardPairs(), kinds = ["fresh", "old", "late"].flatMap(name => [[name, true], [name, false]]);
  const paths = kinds.map(() => []);
  for (const [one, other, loss] of status.mesh.hears) {
    if (chosen !== null && one !== chosen && other !== chosen) continue;
    const back = pairs.get(`${other},${one}`), both = back !== undefined;
    if (both && one > other) continue;
    const worse = Math.max(loss, back ?? 0), kind = worse <= 5 ? 0 : worse <= 30 ? 1 : 2;
    paths[2 * kind + (both ? 0 : 1)].push(one, other);
  }
  pen.globalAlpha = 0.6;
  pen.lineWidth = (pairs.size > MANY ? 1 : 2) * pixel;
  kinds.forEach(([name, both], kind) => {
    pen.strokeStyle = colours[name];
    pen.setLineDash(both ? [] : [4 * pixel, 4 * pixel]);
    pen.beginPath();
    for (let end = 0; end < paths[kind].length; end += 2) {
      const [one, other] = [paths[kind][end], paths[kind][end + 1]];
      pen.moveTo(at[2 * one], at[2 * one + 1]);
      pen.lineTo(at[2 * other], at[2 * other + 1]);
    }
    pen.stroke();
  });
  pen.setLineDash([]);
  pen.globalAlpha = 1;
}

function drawTrails(n, pixel) {
  const step = n > 200 ? 6 : 1;
  pen.strokeStyle = colours.trail; pen.globalAlpha = 0.3; pen.lineWidth = (n > 200 ? 1 : 2) * pixel;
  pen.beginPath();
  for (let robot = 0; robot < n; robot++) {
    if (chosen !== null && robot !== chosen) continue;
    let down = false;
    for (let back = trails.length - 1; back >= 0; back -= step) {
      const x = trails[back][2 * robot], y = trails[back][2 * robot + 1];
      if (x !== x) { down = false; continue; }
      if (down) pen.lineTo(x, y); else pen.moveTo(x, y);
      down = true;
    }
  }
  pen.stroke();
  pen.globalAlpha = 1;
}

// Draws the newest scan of each robot: a thin line along each ray with an echo, and a dot at the echo.
function drawScans(pixel) {
  const lines = new Path2D(), dots = new Path2D(), count = world.getUint16(12, true), dot = 1.6 * pixel;
  let at = moversAt() + world.getUint16(14, true) * MOVER;
  for (let scan = 0; scan < count; scan++) {
    const robot = world.getUint16(at, true), rays = world.getUint16(at + 10, true), ranges = at + SCAN;
    const form = scene.scans.find(form => form.sense === world.getUint8(at + 2));
    const [x, y, heading] = [4, 6, 8].map(field => world.getInt16(at + field, true));
    at = ranges + 2 * rays;
    if (!form || chosen !== null && robot !== chosen) continue;
    const turn = heading / 1e4, [first, last] = form.rays_rad, [ahead, left] = form.mount_m;
    const fromX = x * scene.scale_m + Math.cos(turn) * ahead - Math.sin(turn) * left;
    const fromY = y * scene.scale_m + Math.sin(turn) * ahead + Math.cos(turn) * left;
    for (let ray = 0; ray < rays; ray++) {
      const mm = world.getUint16(ranges + 2 * ray, true);
      if (mm === NO_ECHO) continue;
      const angle = turn + first + (rays > 1 ? ray * (last - first) / (rays - 1) : 0);
      const toX = fromX + mm / 1000 * Math.cos(angle), toY = fromY + mm / 1000 * Math.sin(angle);
      lines.moveTo(fromX, fromY); lines.lineTo(toX, toY);
      dots.moveTo(toX + dot, toY); dots.arc(toX, toY, dot, 0, 2 * Math.PI);
    }
  }
  pen.strokeStyle = pen.fillStyle = colours.robot;
  pen.lineWidth = pixel; pen.globalAlpha = 0.22;
  pen.stroke(lines);
  pen.globalAlpha = 1;
  pen.fill(dots);
}

function drawGoals(at, hull, pixel) {
  const arm = Math.min(hull * 0.5, 7 * pixel);
  pen.strokeStyle = colours.goal; pen.lineWidth = 1.5 * pixel;
  pen.beginPath();
  const shown = goals.map((goal, robot) => [goal, robot]).filter(([goal, robot]) =>
    goal && (chosen === null || scene.unlabelled || robot === chosen));
  const ways = status && scene.waypoints[status.episode - 1] || [];
  for (const [x, y] of shown.flatMap(([, robot]) => ways[robot] || [])) {
    pen.moveTo(x + arm / 2, y); pen.arc(x, y, arm / 2, 0, 2 * Math.PI);
  }
  for (const [[x, y]] of shown) {
    pen.moveTo(x - arm, y - arm); pen.lineTo(x + arm, y + arm);
    pen.moveTo(x - arm, y + arm); pen.lineTo(x + arm, y - arm);
  }
  pen.stroke();
  if (scene.unlabelled) return;
  if (shown.length <= MANY_GOALS) drawGoalNumbers(shown, arm, pixel);
  if (goals.length > MANY_GOALS && chosen === null) return;
  pen.globalAlpha = 0.5; pen.lineWidth = pixel; pen.setLineDash([2 * pixel, 5 * pixel]);
  pen.beginPath();
  goals.forEach((goal, robot) => {
    if (!goal || chosen !== null && robot !== chosen) return;
    if (ways[robot]) {
      // Which of them the robot has passed only its host knows.
      [...ways[robot], goal].forEach(([x, y], k) => k ? pen.lineTo(x, y) : pen.moveTo(x, y));
      return;
    }
    if (at[2 * robot] !== at[2 * robot]) return;
    pen.moveTo(at[2 * robot], at[2 * robot + 1]); pen.lineTo(goal[0], goal[1]);
  });
  pen.stroke();
  pen.setLineDash([]); pen.globalAlpha = 1;
}

// Writes the number of its robot beside each goal.
function drawGoalNumbers(shown, arm, pixel) {
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.fillStyle = colours.goal; pen.textAlign = "left"; pen.textBaseline = "middle";
  pen.font = `600 ${12 * view.k * pixel}px system-ui, sans-serif`;
  for (const [[x, y], robot] of shown) {
    pen.fillText(String(robot), view.x + view.k * (x + arm + 3 * pixel), view.y - view.k * y);
  }
  pen.setTransform(view.k, 0, 0, -view.k, view.x, view.y);
}

function drawRobots(at, n, hull, pixel) {
  const kinds = { robot: [], done: [], halted: [], silent: [] }, hit = [];
  let unseen = 0, headings = 0;
  const noses = [];
  for (let robot = 0; robot < n; robot++) {
    const from = HEADER + robot * ROBOT, phase = world.getUint8(from + 6), age = world.getUint8(from + 7);
    const heading = world.getInt16(from + 4, true), flags = world.getUint8(from + 8);
    if (at[2 * robot] !== at[2 * robot]) { unseen++; continue; }
    kinds[age > SILENT && status?.phase !== 6 ? "silent" : flags & 2 ? "halted" : phase === 4 || phase === 2 ? "done" : "robot"].push(robot);
    if (flags & 1) hit.push(robot);
    if (heading !== UNKNOWN) { headings++; noses.push(robot, heading / 1e4); }
  }
  const circles = (robots, radius) => {
    pen.beginPath();
    for (const robot of robots) {
      const x = at[2 * robot], y = at[2 * robot + 1];
      pen.moveTo(x + radius, y); pen.arc(x, y, radius, 0, 2 * Math.PI);
    }
  };
  for (const [name, robots] of Object.entries(kinds)) {
    pen.fillStyle = colours[name];
    circles(robots, hull);
    pen.fill();
  }
  pen.strokeStyle = colours.hit; pen.lineWidth = 3 * pixel; circles(hit, hull + 2 * pixel); pen.stroke();
  if (chosen !== null) {
    pen.strokeStyle = colours.accent; pen.lineWidth = 3 * pixel; circles([chosen], hull + 4 * pixel); pen.stroke();
  }
  drawNoses(at, noses, hull, pixel);
  if (hull / pixel >= 9) drawNumbers(at, n, hull);
  const left = world.getUint16(10, true);
  set($("note"), [unseen ? `${unseen} of ${n} robots: no position heard` : "",
    unseen < n && headings === 0 ? "no heading heard: none is drawn" : "",
    scene.hears_links ? "" : unheard(),
    left ? `the ${left} longest links are left out` : ""].filter(Boolean).join("; "));
}

// Draws the heading of each robot as a pointer at its hull.
function drawNoses(at, noses, hull, pixel) {
  pen.fillStyle = colours.nose;
  pen.beginPath();
  for (let nose = 0; nose < noses.length; nose += 2) {
    const x = at[2 * noses[nose]], y = at[2 * noses[nose] + 1], heading = noses[nose + 1], tip = 1.3 * hull + pixel;
    pen.moveTo(x + tip * Math.cos(heading), y + tip * Math.sin(heading));
    pen.lineTo(x + hull * Math.cos(heading + 0.45), y + hull * Math.sin(heading + 0.45));
    pen.lineTo(x + hull * Math.cos(heading - 0.45), y + hull * Math.sin(heading - 0.45));
  }
  pen.fill();
}

function drawNumbers(at, n, hull) {
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.fillStyle = colours["on-robot"]; pen.textAlign = "center"; pen.textBaseline = "middle";
  pen.font = `600 ${Math.min(hull * view.k * 0.8, 26)}px system-ui, sans-serif`;
  for (let robot = 0; robot < n; robot++) {
    const x = at[2 * robot];
    if (x === x) pen.fillText(String(robot), view.x + view.k * x, view.y - view.k * at[2 * robot + 1]);
  }
  pen.setTransform(view.k, 0, 0, -view.k, view.x, view.y);
}

// ---- age of the last snapshot, on this page's clock

function checkStale() {
  const age = performance.now() - heardAt;
  stale = age > STALE_MS;
  document.documentElement.classList.toggle("stale", stale);
  if (stale) {
    const over = status && status.over;
    set($("state"), over ? "over" : heardAt > 0 ? "no news" : barred ? "no token" : "connecting");
    $("state").dataset.is = "stale";
    if (over) showEnding();
    else if (heardAt > 0) notice(`No news for ${(age / 1000).toFixed(0)} s: this picture is old.`);
    else if (barred) notice(`${token ? "The token is wrong" : "No token"}: this page shows nothing and stops nobody. ` +
      "Open the address that the program printed, with # and the token behind it.");
  } else if (performance.now() > refusedUntil) {
    if (status && status.over) showEnding();
    else if (status && status.trouble) notice(`${status.trouble}. Nothing of it is shown, and STOP has no effect here.`);
    else if (stopWanted) notice("STOP is sent and not confirmed yet.");
    else if (holder || !scene || scene.control === "stop") notice("");
    else notice("No token: this page can stop the team and nothing else. Open the address that the program printed.");
    if (status) showStatus();
  }
}
setInterval(checkStale, 100);

// A run that ends as it should is no alarm.
function showEnding() {
  const { regular, text } = status.ending || { regular: true, text: "The run is over; this is its last picture." };
  notice(text, regular ? "calm" : "alarm");
}

// ---- buttons and keys

$("stop").onclick = stop;
for (const name of ["rearm", "resume", "pause"]) $(name).onclick = () => send({ do: name });
document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const record = scene && scene.record;
  const keys = record ? { ArrowRight: () => step(false), ArrowLeft: () => step(true), BracketLeft: () => toMark(true),
    BracketRight: () => toMark(false) } : {};
  if (keys[event.code]) { event.preventDefault(); keys[event.code](); return; }
  if (event.code !== "Space" || event.repeat) return;
  event.preventDefault();
  if (record) play(); else stop();
});
// Without this, releasing the space bar would press the button that has the focus.
document.addEventListener("keyup", event => { if (event.code === "Space") event.preventDefault(); });
for (const id of ["show-links", "show-trails", "show-goals", "show-range", "show-scans", "show-hears"]) $(id).onchange = () => { dirty = true; };
$("colour").onchange = () => {
  const words = $("colour").value === "loss" ? ["≤ 5 %", "≤ 30 %", "more"] : ["≤ 0.1 s", "≤ 0.3 s", "older"];
  words.forEach((text, at) => set($(`legend-${at}`), text));
  dirty = true;
};

function seek(at_s) { send({ do: "seek", at_s: Math.min(Math.max(at_s, 0), scene.record.duration_s) }); }
function step(back) { send({ do: "step", back }); }
function play() { send({ do: "play", on: !(status && status.playback && status.playback.playing), rate: rate() }); }
function rate() { return +$("rate").value || 1; }

function toMark(back) {
  const now = recordTime(), marks = scene.record.marks.filter(mark => mark.kind !== "guard").map(mark => mark.at_s);
  const next = back ? marks.filter(at => at < now - 0.05).pop() : marks.find(at => at > now + 0.005);
  seek(next === undefined ? back ? 0 : scene.record.duration_s : next);
}

$("play").onclick = play;
$("step").onclick = () => step(false);
$("step-back").onclick = () => step(true);
$("mark-back").onclick = () => toMark(true);
$("mark-on").onclick = () => toMark(false);
$("rate").onchange = () => {
  const on = !!(status && status.playback && status.playback.playing);
  if (send({ do: "play", on, rate: rate() })) wanted = rate();
};
$("seek").oninput = () => { dragging = true; seek(+$("seek").value); };
$("seek").onchange = () => { dragging = false; };

const onLink = () => {
  set($("delay-text"), `${$("delay").value} ms`);
  set($("loss-text"), `${$("loss").value} %`);
  const fault = { cut: $("cut").checked, delay_ms: +$("delay").value, loss: $("loss").value / 100 };
  send({ do: "link", link: $("link").value, ...fault });
};
for (const id of ["cut", "delay", "loss"]) $(id).onchange = onLink;
for (const [id, unit] of [["delay", "ms"], ["loss", "%"]]) {
  $(id).oninput = () => set($(`${id}-text`), `${$(id).value} ${unit}`);
}
$("link").onchange = () => {
  const now = status && status.impaired[$("link").value] || { cut: false, delay_ms: 0, loss: 0 };
  $("cut").checked = now.cut; $("delay").value = now.delay_ms; $("loss").value = 100 * now.loss;
  set($("delay-text"), `${now.delay_ms} ms`); set($("loss-text"), `${Math.round(100 * now.loss)} %`);
};
for (const id of ["kill", "restart"]) {
  $(id).onclick = () => send({ do: id, role: $("role").value, robot: +$("robot").value });
}

const system = matchMedia("(prefers-color-scheme: dark)");
function theme(name) {
  document.documentElement.dataset.theme = name || (system.matches ? "dark" : "light");
  readColours();
}
$("theme").onclick = () => {
  const next = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  localStorage.setItem("theme", next);
  theme(next);
};
system.onchange = () => theme(localStorage.getItem("theme"));
new ResizeObserver(() => { dirty = true; }).observe(canvas);

// Read by tests of this page: totals, and the transform from metres to pixels of the canvas.
window.murmurate = { counts, view: null, heard: () => performance.now() - heardAt };
theme(localStorage.getItem("theme"));
requestAnimationFrame(draw);
