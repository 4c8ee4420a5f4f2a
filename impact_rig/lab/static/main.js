// The page: takes frames, keeps the snapshot, draws at most once per animation frame, and only what has changed.

import { CurveView } from "./curveview.js";
import { clock, fixed, withUncertainty } from "./format.js";
import { Kind } from "./frames.js";
import { fillSheet, listen } from "./keys.js";
import { KnobPanel } from "./knobs.js";
import { Link } from "./link.js";
import { Clock, Motion } from "./motion.js";
import { forgetColours } from "./paper.js";
import { Player } from "./player.js";
import { drawPhase, drawRig, GLOW_S } from "./rigview.js";
import { ScopeView } from "./scopeview.js";
import { SpectrumView } from "./spectrumview.js";
import { status } from "./store.js";
import { SweepForm } from "./sweep.js";

const byId = (id) => /** @type {any} */ (document.getElementById(id));
const setText = (id, text) => { const node = byId(id); if (node.textContent !== text) node.textContent = text; };

/** @type {Record<string, any>} the snapshot */
const now = {};
const motion = new Motion();
const pace = new Clock(0.12);
const detected = [];
const slow = { factor: 1, time: NaN };
const drawn = { trace: null, number: 0, other: null, epoch: -1, pictures: 0, script: 0, last: 0, phaseAt: 0, rigAt: 0 };
const calm = matchMedia("(prefers-reduced-motion: reduce)");

const link = new Link(onFrame, onConnection);
const act = (what, values = {}) => {
  const { id, answer } = link.ask(what, values);
  answer.then(({ ok, text }) => {
    if (what === "seek" && ok) return;
    setText("answer", text);
    byId("answer").classList.toggle("bad", !ok);
  });
  return { id, answer };
};
const knobs = new KnobPanel(byId("knob-list"), (what, values) => link.ask(what, values));
const scope = new ScopeView(byId("traces"), byId("cursor"));
const curve = new CurveView(byId("curve"), (row) => knobs.turn("frequency", row.f));
const spectrum = new SpectrumView(byId("spectrum-plot"));
const player = new Player(act);
window.lab = { now, drawn, motion, link, scope, curve, spectrum }; // for tests and benchmarks

// What comes in

function onFrame({ kind, number, content }) {
  if (kind === Kind.STATE) {
    Object.assign(now, content);
    for (const part of Object.keys(content)) SHOW[part]?.(content[part]);
    showStatus();
    return;
  }
  if (kind === Kind.TRACE) { drawn.trace = content; drawn.number = number; return; }
  if (number !== drawn.epoch) newRecord(number);
  if (kind === Kind.MOTION) motion.add("states", content);
  else if (kind === Kind.IMPACTS) motion.add("impacts", content);
  else if (kind === Kind.DETECTED) {
    for (let i = 0; i < content.rows; i++) detected.push(content.values[i * content.columns]);
    detected.splice(0, detected.length - 400);
  } else if (kind === Kind.SPECTRUM) spectrum.show(content);
  else if (kind === Kind.TRACE_B) drawn.other = content;
}

function newRecord(epoch) {
  drawn.epoch = epoch;
  drawn.other = null;
  motion.clear();
  detected.length = 0;
  pace.time = NaN;
}

function onConnection(connected) {
  if (!connected) knobs.knobs.lose();
  knobs.refresh();
  showStatus();
}

const SHOW = {
  choices: (choices) => {
    knobs.choose(choices);
    byId("spectrum-channel").replaceChildren(...choices.channels.map((name) => new Option(name, name)));
    byId("spectrum-channel").value = "laser";
    byId("fault-kind").replaceChildren(...Object.keys(choices.faults).map((kind) => new Option(kind.replaceAll("_", " "), kind)));
    byId("fault-kind").value = "offset_step";
    byId("fault-channel").replaceChildren(...choices.channels.map((name) => new Option(name, name)));
    byId("fault-channel").value = "laser";
    showFault();
    look();
  },
  applied: (applied) => {
    knobs.show({ frequency: applied.frequency, current: applied.current });
    spectrum.drive = applied.current > 0 ? applied.frequency : 0;
  },
  knobs: (values) => {
    if (!values) return;
    knobs.show({
      gap: values["sphere.present"] ? values["barriers.gap_m"] : 0, start: values["sphere.start"],
      law: values["contact.law"], restitution: values["contact.restitution"],
    });
    showCurve();
  },
  dt: () => { showDt(); showCurve(); },
  dt_b: () => showCurve(), closed_form: () => showCurve(), prediction: () => showCurve(),
  settling: () => showDt(),
  journal: (lines) => { showJournal(lines); if (now.playback) player.show(now.playback, lines, now.impact_marks); },
  sweep: (sweep) => setText("sweep-text", sweep.text || "not started"),
  recorder: (recorder) => {
    const size = recorder.megabytes ? ` ${fixed(recorder.megabytes, 1)} MB` : "";
    setText("recording", now.mode === "playback" ? recorder.name : recorder.name ? `● ${recorder.name}${size}` : recorder.there ? "off" : "no recorder");
    byId("recording").classList.toggle("bad", recorder.level >= 2);
    byId("record").textContent = recorder.name ? "Stop recording" : "Record";
    byId("record").setAttribute("aria-pressed", String(Boolean(recorder.name)));
  },
  lost: (lost) => {
    const names = Object.keys(lost);
    setText("lost", names.length ? names.map((name) => `${lost[name]} ${name}`).join(", ") : "0");
    byId("lost").classList.toggle("bad", names.length > 0);
  },
  playback: (state) => player.show(state, now.journal, now.impact_marks),
  impact_marks: () => now.playback && player.show(now.playback, now.journal, now.impact_marks),
  mode: (mode) => {
    const live = mode === "live";
    knobs.readOnly = !live;
    knobs.refresh();
    for (const id of ["run", "rest", "pause", "reset", "pluck", "clear", "record", "sweep-start", "sweep-stop", "fault-start", "fault-clear", "note", "stop"]) {
      byId(id).disabled = !live;
    }
    byId("knobs").querySelector("h2").textContent = live ? "Knobs" : "Knobs, as recorded";
    byId("record").hidden = byId("note-form").hidden = byId("sweeping").hidden = byId("faulting").hidden = !live;
    byId("player").hidden = live;
  },
};

// What is shown

function showStatus() {
  const said = status(link.connected, now.rig);
  document.body.dataset.word = said.word;
  document.body.classList.toggle("stale", said.stale);
  setText("lamp", said.lamp);
  setText("word", said.word);
  const rig = now.rig ?? {};
  setText("time", said.stale || rig.time === null ? "–" : clock(now.playback ? now.playback.now : rig.time));
  setText("speed", said.stale || rig.speed === undefined ? "–" : `× ${fixed(rig.speed, rig.speed >= 10 ? 0 : 2)}`);
  byId("pause").setAttribute("aria-pressed", String(said.word === "paused"));
  byId("pause").textContent = said.word === "paused" ? "Go on" : "Pause";
  const noticed = showNotice(said);
  setText("sentence", noticed ? "" : said.text);
  byId("sentence").title = said.text;
}

function showNotice(said) {
  const rig = now.rig ?? {};
  /** @type {[string, () => void][]} */
  const buttons = [];
  if (said.word === "tripped") buttons.push(["Clear trip (C)", () => act("clear_trip")]);
  if (said.word === "choose") for (const name of now.rigs ?? []) buttons.push([name, () => act("choose", { value: name })]);
  if (said.word === "silent") buttons.push(["Go on without it", () => act("pause", { value: false })]);
  if (said.word === "dead" && rig.own) buttons.push(["Start again", () => act("restart")]);
  const gone = Object.entries(now.others ?? {}).filter(([, why]) => why && link.connected);
  if (gone.length && said.word !== "dead") {
    said = { ...said, text: gone.map(([name, why]) => `The ${name} is gone: ${why}.`).join(" ") };
    if (rig.own) buttons.push(["Start again", () => act("restart")]);
    if (now.others.recorder) buttons.push(["Recover the recording", () => act("recover")]);
  }
  const bad = ["tripped", "dead", "silent", "offline"].includes(said.word);
  const shown = buttons.length > 0 || bad;
  byId("notice").hidden = !shown;
  byId("notice").classList.toggle("bad", bad);
  if (!shown) return false;
  const seen = said.word === "dead" && rig.age ? ` Last seen ${rig.age} s ago; what you see is from then.` : "";
  setText("notice-text", said.text + seen);
  const place = byId("notice-buttons"), names = buttons.map(([name]) => name).join();
  if (place.dataset.names === names) return true;
  place.dataset.names = names;
  place.replaceChildren(...buttons.map(([name, run]) => {
    const button = document.createElement("button");
    button.textContent = name;
    button.addEventListener("click", run);
    return button;
  }));
  return true;
}

const gapNow = () => (now.knobs?.["sphere.present"] ? now.knobs["barriers.gap_m"] : now.knobs ? 0 : null);

function showDt() {
  const rows = now.dt ?? [], settling = now.settling ?? {};
  const moving = ["settling", "driving"].includes(settling.word);
  const changed = settling.word === "settling";
  const row = rows[rows.length - 1];
  const old = Boolean(row) && settling.word !== "driving";
  byId("dt-value").classList.toggle("old", old);
  const [value, u] = row && !changed ? withUncertainty(row.dt, row.u) : ["–", ""];
  setText("dt-number", value);
  setText("dt-u", u ? `${u} (2u)` : "");
  byId("settling").hidden = !changed;
  if (changed) {
    const done = settling.done ?? 0, of = settling.of ?? 8;
    byId("settling-bar").value = of ? Math.min(1, done / of) : 0;
    const rest = settling.rest === null ? "" : `, transient ${fixed(100 * settling.rest, 1)} %`;
    setText("settling-text", `settling: window ${fixed(done, 0)} of ${fixed(of, 0)}${rest}`);
  }
  const none = row && !changed && row.ipc === 0 && row.gap ? "no impacts at this gap" : "";
  const more = row && !changed ? {
    [old ? "last, at" : "at"]: `${fixed(row.f, 3)} Hz`, phase: `${fixed(row.phase, 1)}°`, regime: none || row.regime,
    "impacts per cycle": fixed(row.ipc, 2), "|X₁|": `${fixed(row.x1 * 1e3, 3)} mm`, "|X_b|": `${fixed(row.xb * 1e6, 1)} µm`,
  } : {};
  const list = byId("dt-more");
  const words = JSON.stringify(more);
  if (list.dataset.words !== words) {
    list.dataset.words = words;
    list.replaceChildren(...Object.entries(more).map(([name, text]) => {
      const box = document.createElement("div"), dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.textContent = name;
      dd.textContent = text;
      box.append(dt, dd);
      return box;
    }));
  }
  setText("curve-note", settling.refusal && moving && changed ? `last window: ${settling.refusal}` :
    rows.length ? "grey points: other gaps" : "No measurement yet: it appears when the response has settled.");
}

function showCurve() {
  curve.show(now.dt ?? [], now.closed_form ?? [], now.prediction?.lines ?? [], gapNow(), now.dt_b ?? []);
  setText("prediction-note", now.prediction?.words ?? "");
}

function showJournal(lines) {
  const list = byId("journal-list");
  const bottom = list.scrollHeight - list.scrollTop - list.clientHeight < 30;
  list.replaceChildren(...lines.slice(-120).map(([time, kind, key, words]) => {
    const item = document.createElement("li");
    const when = document.createElement("time"), what = document.createElement("span"), how = document.createElement("span");
    when.textContent = clock(time);
    what.textContent = kind.replaceAll("_", " ");
    what.className = "kind";
    how.textContent = `${kind === "parameter" ? key : key.replaceAll("_", " ")} ${words}`.trim();
    how.className = "what";
    item.dataset.kind = kind;
    item.append(when, what, how);
    return item;
  }));
  if (bottom) list.scrollTop = list.scrollHeight;
}

// Drawing

const hurries = () => (now.rig?.speed ?? 1) > 1.5; // rig time runs ahead of ours: the machine is needed elsewhere

function frame(at) {
  if (hurries() && now.mode === "live" && slow.factor === 1) setTimeout(() => requestAnimationFrame(frame), 450);
  else requestAnimationFrame(frame);
  const began = performance.now();
  const dt = Math.min(0.25, (at - (drawn.last || at)) / 1000);
  drawn.last = at;
  if (drawn.trace) {
    const trace = drawn.trace;
    drawn.trace = null;
    if (!byId("hold").checked) {
      const from = trace.begin - 0.01;
      scope.impacts = [motion.impacts.map((row) => row[0]).filter((time) => time >= from), detected.filter((time) => time >= from)];
      scope.draw(trace, drawn.other);
    }
    drawn.pictures++;
    link.acknowledge(drawn.number);
  }
  const rigKnobs = { gap: now.knobs?.["barriers.gap_m"] ?? 0.006, present: now.knobs?.["sphere.present"] ?? true };
  const speed = now.rig?.speed || 1;
  let instant = pace.advance(dt, motion.newest, speed);
  if (now.rig?.motion === false) {
    motion.clear(); // what was drawn last would stand still and look like now
    setText("rig-note", `at × ${fixed(speed, 0)} nobody can follow: the motion is not drawn`);
  } else if (slow.factor < 1) {
    slow.time += dt * slow.factor * speed;
    if (!(slow.time > motion.oldest) || slow.time > motion.newest - 0.02) slow.time = Math.max(motion.oldest, motion.newest - 3 * speed);
    instant = slow.time;
    setText("rig-note", `slow motion, ${fixed(motion.newest - instant, 1)} s ago`);
  } else setText("rig-note", speed > 1.5 ? `at × ${fixed(speed, 0)}` : "");
  const hurried = hurries();
  if (at - drawn.rigAt > (calm.matches ? 500 : 0)) {
    drawn.rigAt = at;
    const calmer = Math.max(slow.factor, 0.05);
    drawRig(byId("rig-canvas"), motion.at(instant, rigKnobs.gap), rigKnobs, (wall) => motion.flash(instant, wall, GLOW_S * calmer), calmer);
  }
  if (at - drawn.phaseAt > (calm.matches ? 1000 : hurried ? 400 : 100)) {
    drawn.phaseAt = at;
    if (byId("phase").offsetParent) drawPhase(byId("phase-canvas"), motion, Math.min(motion.newest, instant + 0.05), rigKnobs, 0.6);
  }
  drawn.script = performance.now() - began;
  window.lab.onDrawn?.(drawn.script);
}

function look() {
  const channel = byId("spectrum-channel").value || "laser";
  spectrum.top = Number(byId("spectrum-top").value);
  link.look({
    span: Number(byId("span").value), columns: Math.max(200, Math.min(1200, Math.round(byId("traces").clientWidth - 74) || 600)),
    trigger: byId("trigger").checked, spectrum: channel, top: spectrum.top,
  });
}

// What people do

function showFault() {
  const [words, board] = now.choices?.faults?.[byId("fault-kind").value] ?? ["", false];
  setText("fault-text", words);
  byId("fault-channel").disabled = board;
}

function theme(next) {
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  const wanted = next ?? localStorage.getItem("theme") ?? (dark ? "dark" : "light");
  if (next) localStorage.setItem("theme", next);
  document.documentElement.dataset.theme = wanted;
  forgetColours();
  scope.make();
  curve.make();
  spectrum.make();
  if (now.playback) player.show(now.playback, now.journal, now.impact_marks);
}

const run = () => knobs.turn("frequency", 9.1).then(() => knobs.turn("current", 0.52));
const rest = () => knobs.turn("current", 0);
const pause = () => (now.mode === "playback" ? player.toggle() : act("pause", { value: now.rig?.word !== "paused" }));
const record = () => act("record", { value: !now.recorder?.name });
const switchTheme = () => theme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
const live = (deed) => () => { if (now.mode === "live") deed(); };
const focus = (id) => () => byId(id).focus();
const bindings = [
  { keys: ["Escape"], text: "STOP: current to zero, latched", run: live(() => act("stop")) },
  { keys: ["r", "R"], text: "run: 9.1 Hz, 0.52 A", run: live(run) },
  { keys: ["0"], text: "rest: current to zero", run: live(rest) },
  { keys: [" "], text: "pause and go on; in playback play and pause", run: pause },
  { keys: ["c", "C"], text: "clear the trip", run: live(() => act("clear_trip")) },
  { keys: ["z", "Z"], text: "reset: scan 0", run: live(() => act("reset")) },
  { keys: ["p", "P"], text: "pluck: free decay from 2 mm", run: live(() => act("pluck", { value: 0.002 })) },
  { keys: ["o", "O"], text: "record, or stop recording", run: live(record) },
  { keys: ["ArrowUp"], text: "frequency up 0.1 Hz", run: live(() => knobs.nudge("frequency", 1)) },
  { keys: ["ArrowDown"], text: "frequency down 0.1 Hz", run: live(() => knobs.nudge("frequency", -1)) },
  { keys: ["]"], text: "frequency up 0.01 Hz", run: live(() => knobs.nudge("frequency", 0.1)) },
  { keys: ["["], text: "frequency down 0.01 Hz", run: live(() => knobs.nudge("frequency", -0.1)) },
  { keys: ["+", "="], text: "current up 0.02 A", run: live(() => knobs.nudge("current", 1)) },
  { keys: ["-"], text: "current down 0.02 A", run: live(() => knobs.nudge("current", -1)) },
  { keys: ["f", "F"], text: "go to the frequency field; ↑ ↓ coarse, with shift fine", run: focus("knob-frequency") },
  { keys: ["i", "I"], text: "go to the current field", run: focus("knob-current") },
  { keys: ["g", "G"], text: "go to the gap field", run: focus("knob-gap") },
  { keys: ["n", "N"], text: "write a remark", run: focus("note") },
  { keys: ["h", "H"], text: "hold the scope", run: () => byId("hold").click() },
  { keys: ["ArrowLeft"], text: "playback: 5 s back", run: () => player.jump(-5) },
  { keys: ["ArrowRight"], text: "playback: 5 s on", run: () => player.jump(5) },
  { keys: ["."], text: "playback: next impact", run: () => now.playback && act("next_impact", { value: 1 }) },
  { keys: [","], text: "playback: impact before", run: () => now.playback && act("next_impact", { value: -1 }) },
  { keys: ["t", "T"], text: "dark or light", run: switchTheme },
  { keys: ["?"], text: "this sheet", run: () => byId("sheet").showModal() },
];
fillSheet(byId("sheet-keys"), bindings);
listen(bindings);

const onClick = (id, deed) => byId(id).addEventListener("click", deed);
for (const [id, what] of [["stop", "stop"], ["reset", "reset"], ["clear", "clear_trip"], ["sweep-stop", "sweep_stop"], ["fault-clear", "clear_faults"]]) {
  onClick(id, () => act(what));
}
onClick("theme", switchTheme);
onClick("help", () => byId("sheet").showModal());
onClick("run", run);
onClick("rest", rest);
onClick("pause", pause);
onClick("pluck", () => act("pluck", { value: 0.002 }));
onClick("record", record);
const onSubmit = (id, deed) => byId(id).addEventListener("submit", (event) => { event.preventDefault(); deed(); });
new SweepForm(byId, act);
onSubmit("fault-form", () => act("fault", {
  kind: byId("fault-kind").value, channel: byId("fault-channel").disabled ? "" : byId("fault-channel").value,
  value: byId("fault-value").valueAsNumber, duration: byId("fault-duration").valueAsNumber, rate: byId("fault-rate").valueAsNumber,
}));
onSubmit("note-form", () => {
  act("note", { value: byId("note").value });
  byId("note").value = "";
});
byId("fault-kind").addEventListener("change", showFault);
for (const id of ["span", "trigger", "spectrum-channel", "spectrum-top"]) byId(id).addEventListener("change", look);
byId("spectrum-db").addEventListener("change", () => { spectrum.db = byId("spectrum-db").checked; spectrum.make(); });
byId("hold").addEventListener("change", () => setText("scope-note", byId("hold").checked ? "held" : ""));
for (const button of document.querySelectorAll("[data-slow]")) {
  button.addEventListener("click", () => {
    slow.factor = Number(/** @type {HTMLElement} */ (button).dataset.slow);
    slow.time = NaN;
    for (const one of document.querySelectorAll("[data-slow]")) one.setAttribute("aria-pressed", String(one === button));
  });
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (!localStorage.getItem("theme")) theme(); });
new ResizeObserver(look).observe(byId("traces"));
theme();
look();
requestAnimationFrame(frame);
