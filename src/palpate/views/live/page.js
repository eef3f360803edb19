// Live view: draws the frames that the server makes of a session's log. Plain SVG, nothing from elsewhere.
"use strict";

const NS = "http://www.w3.org/2000/svg";
const NORMAL_MM = 14;
const HYPOTHESES_LISTED = 4;  // of one part; of several, fewer of each, but two
const PLACES_LISTED = 9;
const HUES = 5;
const POINT_MM = 0.8;
const token = document.querySelector('meta[name="palpate-token"]').content;
const isRun = document.querySelector('meta[name="palpate-kind"]').content === "run";
const byId = (id) => document.getElementById(id);

let setting = null;
let following = true;   // shows the newest frame, not the slider's
let playing = null;
let newest = 0;

function make(name, attributes, parent) {
  const item = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) item.setAttribute(key, value);
  if (parent) parent.appendChild(item);
  return item;
}

function element(name, text, parent) {
  const item = document.createElement(name);
  item.textContent = text;
  if (parent) parent.appendChild(item);
  return item;
}

// The table's y axis points up, the screen's down.
const at = ([x, y]) => [x, -y];

function outline(item) {
  const rings = setting.outlines[`${item.object}/${item.state}`] || [];
  const c = Math.cos(item.theta), s = Math.sin(item.theta);
  return rings.map((ring) => "M" + ring.map(([x, y]) =>
    at([c * x - s * y + item.x, s * x + c * y + item.y]).map((v) => v.toFixed(2)).join(" ")).join("L") + "Z").join("");
}

function sector(centre, radius, lo, hi) {
  const point = (angle, r) => at([centre[0] + r * Math.cos(angle), centre[1] + r * Math.sin(angle)]);
  const [x, y] = at(centre), [x1, y1] = point(lo, radius), [x2, y2] = point(hi, radius);
  return `M${x} ${y}L${x1} ${y1}A${radius} ${radius} 0 ${hi - lo > Math.PI ? 1 : 0} 0 ${x2} ${y2}Z`;
}

// A pad's face as a line across the way from one place to another, its middle there.
function face(kind, from, middle, half, parent) {
  const u = middle[0] - from[0], v = middle[1] - from[1], far = Math.hypot(u, v) || 1;
  const [x1, y1] = at([middle[0] - half * v / far, middle[1] + half * u / far]);
  const [x2, y2] = at([middle[0] + half * v / far, middle[1] - half * u / far]);
  make("line", { class: `${kind} face`, x1, y1, x2, y2 }, parent);
}

function label(words, x, y, size, kind, parent) {
  const item = make("text", { class: kind, x, y, "font-size": size, dy: "0.35em" }, parent);
  item.textContent = words;
}

const listed = (frame) => Math.max(2, Math.floor(HYPOTHESES_LISTED / frame.parts.length));

// Classes of outlines, part by part: a part's only hypothesis, or one of several, none of which is the answer.
function hues(frame) {
  let next = 0;
  return frame.parts.map((part) => part.hypotheses.map((_, k) =>
    part.left === 1 ? "only" : k < listed(frame) ? `h${next++ % HUES}` : ""));
}

// Number of a part beside others, in the middle of its heaviest hypothesis.
function drawNumber(part, px, svg) {
  const item = part.hypotheses[0], [u, v] = setting.middles[`${item.object}/${item.state}`] || [0, 0];
  const c = Math.cos(item.theta), s = Math.sin(item.theta);
  label(part.number, ...at([c * u - s * v + item.x, s * u + c * v + item.y]), 18 * px, "part", svg);
}

// Coordinates below and right of the square that shows the workspace; `px`: mm of a pixel.
function drawAxes(reach, px, svg) {
  const power = 10 ** Math.floor(Math.log10(reach / 2)), step = [5, 2, 1].find((n) => n * power <= reach / 2) * power;
  for (let v = -Math.floor(reach / step) * step; v <= reach; v += step) {
    make("path", { class: "grid", d: `M${v} ${-reach}V${reach}M${-reach} ${-v}H${reach}` }, svg);
    label(v, v, reach + 10 * px, 12 * px, "tick", svg);
    label(v, reach + 16 * px, -v, 12 * px, "tick", svg);
  }
  const far = reach / 6, head = 5 * px;
  make("path", { class: "axis", d: `M0 ${-far}V0H${far}m${-head} ${-head}l${head} ${head}l${-head} ${head}` +
    `M${-head} ${head - far}L0 ${-far}l${head} ${head}` }, svg);
  label("x", far + 9 * px, 0, 12 * px, "tick", svg);
  label("y", 0, -far - 9 * px, 12 * px, "tick", svg);
  label("mm", reach + 16 * px, reach + 10 * px, 12 * px, "tick", svg);
}

function drawContact(item, frame, px, svg) {
  const [x1, y1] = at(item.start), [x2, y2] = at(item.end);
  if (!item.touched) { make("line", { class: "miss", x1, y1, x2, y2 }, svg); return; }
  if (item.grip === frame.grip && !frame.end) make("line", { class: "way", x1, y1, x2, y2 }, svg);
  if (item.normal) make("path", { class: "normal", d: sector(item.end, NORMAL_MM / 2 + item.radius, ...item.normal) }, svg);
  if (item.pad) {
    face("contact", item.start, item.end, item.radius, svg);
    for (const place of item.places) {
      const [cx, cy] = at(place.at);
      make("circle", { class: "point", cx, cy, r: POINT_MM }, svg);
    }
  } else {
    make("circle", { class: "contact", cx: x2, cy: y2, r: Math.max(item.radius, 8 * px) }, svg);
  }
  const far = Math.hypot(x1 - x2, y1 - y2) || 1, back = item.pad ? 11 * px : 0;
  label(item.grip, x2 + back * (x1 - x2) / far, y2 + back * (y1 - y2) / far, 12 * px, "number", svg);
}

function drawTable(frame) {
  const svg = byId("table"), box = svg.getBoundingClientRect();
  const reach = setting.workspace * 1.12, px = 2 * reach / (Math.min(box.width, box.height) - 60 || 600);
  const [w, h] = [box.width * px / 2, box.height * px / 2];
  svg.setAttribute("viewBox", `${14 * px - w} ${10 * px - h} ${2 * w} ${2 * h}`);
  svg.replaceChildren();
  drawAxes(reach, px, svg);
  make("circle", { class: "workspace", cx: 0, cy: 0, r: setting.workspace }, svg);
  const classes = hues(frame);
  frame.parts.forEach((part, n) => part.hypotheses.forEach((item, k) =>
    make("path", { class: `outline ${classes[n][k]}`, d: outline(item) }, svg)));
  for (const item of frame.truths) make("path", { class: "truth", d: outline(item) }, svg);
  for (const item of frame.contacts) drawContact(item, frame, px, svg);
  if (frame.divisions !== null) for (const part of frame.parts) drawNumber(part, px, svg);
  for (const item of frame.plan) {
    const way = (travel) => at([item.start[0] + travel * Math.cos(item.direction),
      item.start[1] + travel * Math.sin(item.direction)]);
    const [x1, y1] = way(0), [x2, y2] = way(item.travel);
    make("line", { class: "plan", x1, y1, x2, y2 }, svg);
    for (const [lo, hi] of item.stops) {
      if (lo === null) continue;
      const [xa, ya] = way(lo), [xb, yb] = way(hi === null ? item.travel : hi);
      make("line", { class: "stops", x1: xa, y1: ya, x2: xb, y2: yb }, svg);
    }
  }
  for (const finger of setting.fingers) {
    const place = frame.tips[finger.name], body = frame.bodies[finger.name];
    if (!place) continue;
    make("path", { class: "body", d: "M" + [...body.joints, place].map((p) => at(p).join(" ")).join("L"),
      "stroke-width": body.width }, svg);
    const [bx, by] = at(body.joints[0]);
    make("circle", { class: "base", cx: bx, cy: by, r: 0.7 * body.width }, svg);
    const [cx, cy] = at(place), last = at(body.joints.at(-1)), far = Math.hypot(last[0] - cx, last[1] - cy) || 1;
    if (finger.pad) face("tip", body.joints.at(-1), place, finger.radius, svg);
    else make("circle", { class: "tip", cx, cy, r: finger.radius }, svg);
    const back = finger.radius + 22 * px;
    label(finger.name, cx + back * (last[0] - cx) / far, cy + back * (last[1] - cy) / far, 13 * px, "finger", svg);
  }
}

function drawLegend() {
  const keys = [["tip", "finger’s tip", "M15 10m-5 0a5 5 0 1 0 10 0a5 5 0 1 0-10 0"],
    ["contact", "contact, by grip", "M15 10m-6 0a6 6 0 1 0 12 0a6 6 0 1 0-12 0"],
    ["normal", "range of its normal", "M4 10L27 4V16Z"], ["outline h0", "hypothesis", "M4 5H26V15H4Z"],
    ["outline only", "the only one left", "M4 5H26V15H4Z"], ["plan", "planned approach", "M2 10H28"],
    ["stops", "where it may stop", "M8 10H22"], ["truth", "true pose (emulated)", "M2 10H28"]];
  for (const [kind, words, d] of keys) {
    const item = element("li", "", byId("legend"));
    make("path", { class: kind, d }, make("svg", { viewBox: "0 0 30 20", "aria-hidden": "true" }, item));
    element("span", words, item);
  }
}

function drawHypotheses(frame) {
  const list = byId("hypotheses"), [goalMm, goalDeg] = setting.goal, classes = hues(frame);
  list.replaceChildren();
  byId("goal").textContent = `goal: within ± ${goalMm} mm, ± ${goalDeg}°`;
  frame.parts.forEach((part, n) => {
    if (frame.divisions !== null) element("h3", `part ${part.number}${part.verdict ? `: ${part.verdict}` : ""}`, element("li", "", list));
    part.hypotheses.slice(0, listed(frame)).forEach((item, k) => drawHypothesis(item, classes[n][k], goalMm, goalDeg, list));
    const more = part.left - listed(frame);
    if (more > 0) element("li", `and ${more} more`, list);
  });
  if (!frame.parts.length) element("li", frame.verdict ? "none" : "nothing touched yet", list);
  const ways = frame.divisions > 1 ? `touches may be those of one part or another in ${frame.divisions} ways` : "";
  byId("rest").textContent = [ways, frame.rest].filter(Boolean).join("; ");
}

function drawHypothesis(item, kind, goalMm, goalDeg, list) {
  const row = element("li", "", list);
  element("span", `${item.object}, ${item.state}`, row).className = kind;
  element("b", `${(100 * item.weight).toFixed(0)} %`, row);
  const bounds = element("small", "", row), turn = item.bounds.theta_rad.map((v) => v * 180 / Math.PI);
  const values = [["x", item.bounds.x_mm, goalMm, ""], ["y", item.bounds.y_mm, goalMm, ""]];
  if (!item.round) values.push(["θ", turn, goalDeg, "°"]);
  for (const [name, [lo, hi], goal, unit] of values) {
    const middle = ((lo + hi) / 2).toFixed(2), half = Math.max(hi - middle, middle - lo), met = (hi - lo) / 2 <= goal;
    const words = `${name} ${middle} ± ${(Math.ceil(half * 100 - 1e-6) / 100).toFixed(2)}${unit}`;
    element("i", words + (met ? " ✓" : ""), bounds).className = met ? "met" : "";
  }
}

function drawArrays(frame) {
  const box = byId("arrays");
  box.replaceChildren();
  for (const [name, array] of Object.entries(frame.arrays)) {
    const figure = element("figure", "", box);
    const svg = make("svg", { viewBox: `0 0 ${array.columns} ${array.rows}`, role: "img", "aria-label": `taxels of ${name}` }, figure);
    const heat = Uint8Array.from(atob(array.heat), (c) => c.charCodeAt(0));
    heat.forEach((value, k) => {
      if (value < 8) return;
      const row = Math.floor(k / array.columns);
      make("rect", { x: k % array.columns, y: array.rows - 1 - row, width: 1, height: 1,
        fill: "var(--touch)", opacity: value / 255 }, svg);
    });
    element("figcaption", `${name} ${array.force.toFixed(2)} N`, figure);
  }
  byId("scale").hidden = !Object.keys(frame.arrays).length;
  byId("full").textContent = `${frame.scale_n.toPrecision(2)} N on a taxel`;
}

function drawContacts(frame) {
  const body = byId("contacts").tBodies[0];
  body.replaceChildren();
  const places = frame.contacts.flatMap((item) => item.places.map((place) => ({ item, place })));
  byId("contacts").classList.toggle("no-normals", !places.some(({ item }) => item.normal));
  for (const { item, place } of places.slice(-PLACES_LISTED).reverse()) {
    const row = element("tr", "", body);
    const degrees = item.normal ? item.normal.map((v) => v * 180 / Math.PI) : null;
    const normal = degrees ? `${(((degrees[0] + degrees[1]) / 2 + 360) % 360).toFixed(0)} ± ${((degrees[1] - degrees[0]) / 2).toFixed(0)}` : "";
    const where = item.touched ? place.at.map((v) => v.toFixed(2)).join(", ") : "missed";
    const bound = item.touched ? (Math.ceil(100 * place.bound) / 100).toFixed(2) : "";
    [item.grip, place.name, where, bound, normal, item.force === null || item.force === undefined ? "" : item.force.toFixed(2)]
      .forEach((value) => element("td", value, row));
  }
  const earlier = places.length - PLACES_LISTED;
  if (earlier > 0) element("td", `and ${earlier} earlier`, element("tr", "", body)).colSpan = 6;
}

function title(frame) {
  if (frame.end && frame.end.how !== "done") return `ended: ${frame.end.how}`;
  if (frame.answer) return frame.answer;
  if (!frame.verdict) return frame.doing ? setting.rig : "looking";
  if (!frame.parts.length) return frame.verdict;
  return frame.parts.map(({ hypotheses: [first], left, number }) => (frame.divisions === null ? "" : `part ${number}: `) +
    (left === 1 ? `only ${first.object}, ${first.state} is left` : `${left} hypotheses`)).join("; ");
}

function draw(frame) {
  byId("title").textContent = title(frame);
  document.title = `${title(frame)} – ${setting.rig}`;
  const torque = Object.values(frame.torque).some(Boolean) ? "torque on" : "torque off";
  const doing = frame.end ? "the run has ended" : frame.stage ? `grip ${frame.grip}: ${frame.stage}` : frame.doing || "connecting";
  byId("doing").textContent = frame.end ? frame.end.message || doing : `${doing}, ${torque}`;
  byId("clock").textContent = `${frame.t.toFixed(2)} s`;
  const button = byId("stop");
  if (frame.end && !button.disabled) button.hidden = true;  // once pressed, it says what came of it
  drawTable(frame); drawHypotheses(frame); drawArrays(frame); drawContacts(frame);
}

async function ask(path, options) {
  const answer = await fetch(path, options);
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json();
}

async function show(t) {
  const frame = await ask(`frame?t=${t}`);
  if (frame) draw(frame);
}

function slide(extent) {
  newest = extent.last;
  const slider = byId("time");
  slider.min = extent.first; slider.max = extent.last;
  slider.hidden = byId("play").hidden = false;
  byId("live").hidden = !isRun || extent.ended || following;
  if (following) slider.value = extent.last;
}

function pause() {
  clearInterval(playing);
  playing = null;
  byId("play").textContent = "play";
}

function play() {
  if (playing) { pause(); return; }
  const slider = byId("time");
  if (Number(slider.value) >= newest) slider.value = slider.min;
  following = false;
  byId("play").textContent = "pause";
  playing = setInterval(async () => {
    slider.value = Number(slider.value) + 0.1;
    await show(slider.value);
    if (Number(slider.value) >= newest) pause();
  }, 100);
}

async function stop() {
  const button = byId("stop");
  button.disabled = true;
  button.textContent = "stopping …";
  try {
    const said = await ask("stop", { method: "POST", headers: { "X-Palpate-Token": token } });
    button.textContent = said.words;
  } catch (error) {
    button.disabled = false;
    button.textContent = "STOP";
    byId("doing").textContent = `not stopped: ${error.message}`;
  }
}

function listen() {
  const source = new EventSource("stream");
  source.onmessage = (message) => {
    const frame = JSON.parse(message.data);
    newest = frame.t;
    if (following) draw(frame);
    slide({ first: Number(byId("time").min), last: newest, ended: Boolean(frame.end) });
  };
  source.addEventListener("end", async () => {
    source.close();
    slide(await ask("extent"));
    if (following) await show(newest);
  });
  source.onerror = () => { byId("doing").textContent = "the view has ended or cannot be reached"; };
}

async function begin() {
  setting = await ask("setting");
  drawLegend();
  byId("stop").hidden = !isRun;
  document.body.classList.toggle("bare", !Object.keys(setting.outlines).length);
  byId("stop").addEventListener("click", stop);
  byId("play").addEventListener("click", play);
  byId("live").addEventListener("click", () => { pause(); following = true; });
  byId("time").addEventListener("input", async (event) => { following = false; pause(); await show(event.target.value); });
  listen();
}

begin().catch((error) => { byId("title").textContent = `no session: ${error.message}`; });
