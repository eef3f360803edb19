// Live view: draws the frames that the server makes of a session's log. Plain SVG, nothing from elsewhere.
"use strict";

const NS = "http://www.w3.org/2000/svg";
const NORMAL_MM = 14;
const HYPOTHESES_LISTED = 8;
const PLACES_LISTED = 9;
const POINT_MM = 0.8;
const token = document.querySelector('meta[name="palpate-token"]').content;
const isRun = document.querySelector('meta[name="palpate-kind"]').content === "run";
const byId = (id) => document.getElementById(id);

let setting = null;
let following = true;   // shows the newest frame, not the slider's
let playing = null;
let newest = 0;
let skipped = 0;

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

function drawTable(frame) {
  const svg = byId("table");
  const reach = setting.workspace * 1.25;
  svg.setAttribute("viewBox", `${-reach} ${-reach} ${2 * reach} ${2 * reach}`);
  svg.replaceChildren();
  make("circle", { class: "workspace", cx: 0, cy: 0, r: setting.workspace }, svg);
  frame.hypotheses.slice().reverse().forEach((item, k, all) => {
    make("path", { class: k === all.length - 1 ? "found" : "rival", d: outline(item),
      opacity: Math.max(0.25, Math.min(1, item.weight)) }, svg);
  });
  if (frame.truth) make("path", { class: "truth", d: outline(frame.truth) }, svg);
  for (const item of frame.contacts) {
    const [x1, y1] = at(item.start), [x2, y2] = at(item.end);
    if (item.grip === frame.grip && !frame.end) make("line", { class: "way", x1, y1, x2, y2 }, svg);
    if (!item.touched) continue;
    if (item.pad) {
      face("contact", item.start, item.end, item.radius, svg);
      for (const place of item.places) {
        const [cx, cy] = at(place.at);
        make("circle", { class: "point", cx, cy, r: POINT_MM }, svg);
      }
      continue;
    }
    make("circle", { class: "contact", cx: x2, cy: y2, r: item.radius }, svg);
    if (item.normal) make("path", { class: "normal", d: sector(item.end, NORMAL_MM / 2 + item.radius, ...item.normal) }, svg);
  }
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
    const place = frame.tips[finger.name];
    if (!place) continue;
    const [cx, cy] = at(place);
    if (finger.pad) face("tip", finger.base, place, finger.radius, svg);
    else make("circle", { class: "tip", cx, cy, r: finger.radius }, svg);
    const label = make("text", { class: "finger", x: cx, y: cy - finger.radius - 2, "font-size": reach / 24 }, svg);
    label.textContent = finger.name;
  }
}

function drawHypotheses(frame) {
  const list = byId("hypotheses");
  list.replaceChildren();
  for (const item of frame.hypotheses.slice(0, HYPOTHESES_LISTED)) {
    const row = element("li", "", list);
    element("span", `${item.object}, ${item.state}`, row);
    element("b", `${(100 * item.weight).toFixed(1)} %`, row);
    const theta = item.round ? "any" : `${(item.theta * 180 / Math.PI).toFixed(1)}°`;
    element("small", `x ${item.x.toFixed(2)} mm, y ${item.y.toFixed(2)} mm, θ ${theta}`, row);
  }
  const more = frame.left - HYPOTHESES_LISTED;
  if (more > 0) element("li", `and ${more} more`, list);
  if (!frame.hypotheses.length) element("li", frame.verdict ? "none" : "nothing touched yet", list);
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
    element("figcaption", `${name}: ${array.most > 0 ? array.most.toFixed(0) : 0} counts over rest`, figure);
  }
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

function drawPlan(frame) {
  const list = byId("plan");
  list.replaceChildren();
  for (const item of frame.plan) {
    const hits = item.stops.filter(([lo]) => lo !== null).length;
    element("li", `${setting.fingers[item.finger].name}: ${hits} of ${item.stops.length} hypotheses stop it`, list);
  }
  if (!frame.plan.length) element("li", "–", list);
}

function title(frame) {
  const first = frame.hypotheses[0];
  if (frame.end && frame.end.how !== "done") return `ended: ${frame.end.how}`;
  if (!frame.verdict) return frame.doing ? setting.rig : "looking";
  return first ? `${frame.verdict}: ${first.object}, ${first.state}` : frame.verdict;
}

function draw(frame) {
  byId("title").textContent = title(frame);
  document.title = `${title(frame)} – ${setting.rig}`;
  const torque = Object.values(frame.torque).some(Boolean) ? "torque on" : "torque off";
  const doing = frame.end ? "the run has ended" : frame.stage ? `grip ${frame.grip}: ${frame.stage}` : frame.doing || "connecting";
  byId("doing").textContent = frame.end ? frame.end.message || doing : `${doing}, ${torque}`;
  byId("clock").textContent = `${frame.t.toFixed(2)} s`;
  byId("counts").textContent = `${frame.frames} array frames` + (isRun && skipped ? `, ${skipped} pictures skipped` : "");
  const button = byId("stop");
  if (frame.end && !button.disabled) button.hidden = true;  // once pressed, it says what came of it
  drawTable(frame); drawHypotheses(frame); drawArrays(frame); drawContacts(frame); drawPlan(frame);
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
  source.addEventListener("end", async (message) => {
    skipped = JSON.parse(message.data).skipped;
    source.close();
    slide(await ask("extent"));
    if (following) await show(newest);
  });
  source.onerror = () => { byId("doing").textContent = "the view has ended or cannot be reached"; };
}

async function begin() {
  setting = await ask("setting");
  byId("stop").hidden = !isRun;
  document.body.classList.toggle("bare", !Object.keys(setting.outlines).length);
  byId("stop").addEventListener("click", stop);
  byId("play").addEventListener("click", play);
  byId("live").addEventListener("click", () => { pause(); following = true; });
  byId("time").addEventListener("input", async (event) => { following = false; pause(); await show(event.target.value); });
  listen();
}

begin().catch((error) => { byId("title").textContent = `no session: ${error.message}`; });
