// The page: it receives frames, keeps the snapshot, and draws at most once per animation frame, only what has changed.

import { CurveView } from "./curveview.js";
import { clock, fixed, withUncertainty } from "./format.js";
import { Kind } from "./frames.js";
import { fillSheet, listen } from "./keys.js";
import { KnobPanel, SweepForm } from "./knobs.js";
import { Link } from "./link.js";
import { Clock, LONGEST_WINDOW_S, Motion } from "./motion.js";
import { byId, element } from "./page.js";
import { forgetColours, save, savePicture } from "./paper.js";
import { Player } from "./player.js";
import { drawPhase, drawRig, GLOW_S } from "./rigview.js";
import { ScopeView } from "./scopeview.js";
import { SpectrumView } from "./spectrumview.js";
import { GRAVE, holds, status } from "./store.js";

const setText = (id, text) => { const node = byId(id); if (node.textContent !== text) node.textContent = text; };
const say = (id, text, bad) => { setText(id, text); byId(id).classList.toggle("bad", Boolean(bad)); };

/** @type {Record<string, any>} the snapshot */
const now = {};
const motion = new Motion();
const pace = new Clock(0.12);
const detected = [];
const slow = { factor: 1, time: NaN };
const drawn = { trace: null, number: 0, other: null, beside: null, epoch: -1, pictures: 0, script: 0, last: 0, phaseAt: 0, rigAt: 0 };
const calm = matchMedia("(prefers-reduced-motion: reduce)");

const LOST_S = 5; // rig time for which a loss is shown in full
let answeredAt = 0, lastLost = { words: "", at: 0 };
const link = new Link(onFrame, onConnection);
const act = (what, values = {}) => {
  const { id, answer } = link.ask(what, values);
  answer.then(({ ok, text }) => {
    if (what === "seek" && ok) return;
    say("answer", text, !ok);
    answeredAt = Date.now();
  });
  return { id, answer };
};
const knobs = new KnobPanel(byId("knob-list"), (what, values) => {
  setText("answer", ""); // a knob shows its own result
  return link.ask(what, values);
});
const scope = new ScopeView(byId("traces"), byId("cursor"));
const curve = new CurveView(byId("curve"), (row) => knobs.turn("frequency", row.f), (row) => { curve.remove(row); showCurve(); });
const spectrum = new SpectrumView(byId("spectrum-plot"));
const player = new Player(act);
window.lab = { now, drawn, motion, link, scope, curve, spectrum }; // for tests and benchmarks

// Input

function onFrame({ kind, number, content }) {
  if (kind === Kind.STATE) {
    Object.assign(now, content);
    for (const part of Object.keys(content)) SHOW[part]?.(content[part]);
    link.rig = now.rig?.instance ?? null;
    showStatus();
    explain();
    return;
  }
  if (kind === Kind.TRACE) { // other frames before it belong to the same picture
    Object.assign(drawn, { trace: content, number, other: drawn.beside, beside: null });
    return;
  }
  if (number !== drawn.epoch) newRecord(number);
  if (kind === Kind.MOTION) motion.add("states", content);
  else if (kind === Kind.IMPACTS) motion.add("impacts", content);
  else if (kind === Kind.DETECTED) {
    for (let i = 0; i < content.rows; i++) detected.push(content.values[i * content.columns]);
    while (detected.length && detected[0] < detected[detected.length - 1] - LONGEST_WINDOW_S) detected.shift();
  } else if (kind === Kind.SPECTRUM) spectrum.show(content);
  else if (kind === Kind.TRACE_B) drawn.beside = content;
}

function newRecord(epoch) {
  drawn.epoch = epoch;
  drawn.other = drawn.beside = null;
  motion.clear();
  detected.length = 0;
  pace.time = NaN;
}

function onConnection(connected) {
  if (!connected) {
    knobs.knobs.lose();
    drawn.epoch = -1; // a restarted lab counts its records from 0
  }
  knobs.refresh();
  showStatus();
}

const SHOW = {
  choices: (choices) => {
    knobs.choose(choices);
    for (const id of ["spectrum-channel", "fault-channel"]) {
      byId(id).replaceChildren(...choices.channels.map((name) => new Option(name, name)));
      byId(id).value = "laser";
    }
    byId("fault-kind").replaceChildren(...Object.keys(choices.faults).map((kind) => new Option(kind.replaceAll("_", " "), kind)));
    byId("fault-kind").value = "offset_step";
    showFault();
    look();
  },
  applied: (applied) => {
    knobs.show({ frequency: applied?.frequency ?? null, current: applied?.current ?? null });
    spectrum.drive = applied?.current > 0 ? applied.frequency : 0;
    spectrum.plot.redraw(false);
  },
  knobs: (values) => {
    knobs.boxes.current.box.querySelector(".unit").textContent = now.choices?.units[values?.["drive.kind"]] ?? "A";
    knobs.show({
      gap: gapNow(), start: values?.["sphere.start"] ?? null, law: values?.["contact.law"] ?? null,
      restitution: values?.["contact.restitution"] ?? null,
    });
    showCurve();
  },
  help: () => fillWords(),
  dt: () => { showDt(); showCurve(); },
  dt_now: () => showDt(),
  dt_b: () => showCurve(), closed_form: () => showCurve(), prediction: () => showCurve(),
  other_motion: (words) => setText("other-motion", words),
  journal: (lines) => { showJournal(lines); showPlayer(); },
  sweep: (sweep) => setText("sweep-text", sweep.text || "not started"),
  recorder: (recorder) => {
    const size = recorder.megabytes ? ` ${fixed(recorder.megabytes, 1)} MB` : "";
    const records = Boolean(recorder.lives && recorder.name);
    const trouble = ["failed", "rival", "losing"].includes(recorder.state) ? ` ${recorder.state}` : "";
    say("recording", now.mode === "playback" ? recorder.name
      : !recorder.lives ? "no recorder" : records ? `● ${recorder.name}${size}${trouble}` : trouble.trim() || "off", trouble || recorder.gone);
    byId("recording").title = recorder.reason || recorder.gone || "";
    byId("record").textContent = records ? "Stop recording" : "Record";
    byId("record").setAttribute("aria-pressed", String(records));
    byId("record").disabled = now.mode !== "live" || !recorder.lives;
  },
  lost: (lost) => {
    const names = Object.keys(lost ?? {}), words = names.map((name) => `${lost[name]} ${name}`).join(", ");
    if (words !== lastLost.words) lastLost = { words, at: now.rig?.time ?? 0 };
  },
  faults: (faults) => say("faults", faults ? faults.join(", ") || "none" : "–", faults?.length),
  health: (health) => {
    const bad = health ? Object.entries(health).map(([channel, word]) => `${channel}: ${word}`) : [];
    say("health", health ? bad.join(", ") || "well" : "–", bad.length);
  },
  stream: (stream) => {
    byId("stream-box").hidden = !stream;
    if (!stream) return;
    const troubles = [["missing", " s missing"], ["late", " s late"], ["refused", " blocks refused"]].filter(([name]) => stream[name]);
    const words = troubles.map(([name, what]) => `, ${fixed(stream[name], name === "refused" ? 0 : 2)}${what}`);
    say("stream", `${fixed(stream.buffered, 2)} of ${fixed(stream.capacity, 1)} s${words.join("")}`, troubles.length);
  },
  refused: (refused) => {
    const names = Object.keys(refused);
    byId("refused-box").hidden = !names.length;
    setText("refused", names.map((name) => `${refused[name][0]} of ${name}`).join(", "));
    byId("refused").title = names.map((name) => `${name}: ${refused[name][1]}`).join("\n");
  },
  playback: (state) => {
    showPlayer();
    byId("legend").hidden = state.names.length < 2;
    setText("legend-a", state.names[0]);
    setText("legend-b", state.names[1] ?? "");
  },
  impact_marks: () => showPlayer(),
  mode: (mode) => {
    const live = mode === "live";
    knobs.readOnly = !live;
    knobs.refresh();
    for (const id of ["run", "rest", "pause", "reset", "pluck", "clear", "record", "sweep-start", "sweep-stop", "fault-start", "fault-clear", "note", "stop", "settings-save", "settings-load"]) {
      byId(id).disabled = !live;
    }
    byId("knobs").querySelector("h2").textContent = live ? "Knobs" : "Knobs, as recorded";
    byId("record").hidden = byId("note-form").hidden = byId("sweeping").hidden = byId("faulting").hidden = byId("settings").hidden = !live;
    byId("player").hidden = live;
  },
};

// Display

function showPlayer() {
  if (now.playback && now.journal) showJournal(now.journal);
  if (now.playback) player.show(now.playback, now.journal, now.impact_marks);
}

function showStatus() {
  const said = status(link.connected, now.rig);
  document.body.dataset.word = said.word;
  document.body.classList.toggle("stale", said.stale);
  setText("lamp", said.lamp);
  setText("word", said.word);
  const rig = now.rig ?? {};
  const known = `${said.word} ${rig.instance ?? ""}`;
  if (document.body.dataset.known !== known) { // values rejected before may be accepted now
    document.body.dataset.known = known;
    knobs.forgive();
    if (byId("answer").classList.contains("bad") && Date.now() - answeredAt > 1000) setText("answer", "");
    showDt();
  }
  showLost();
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
  if (said.word === "silent peer") buttons.push(["Continue without it", () => act("pause", { value: false })]);
  if (said.word === "dead" && rig.own) buttons.push(["Start again", () => act("restart")]);
  const gone = ["analysis", "recorder"].filter((name) => now.sources?.[name]?.gone && link.connected);
  if (gone.length && said.word !== "dead") {
    const texts = gone.filter((name) => !said.text.includes(now.sources[name].gone)).map((name) => `The ${name} is gone: ${now.sources[name].gone}.`);
    said = { ...said, text: [said.text, ...texts].join(" ") };
    if (rig.own) buttons.push(["Start again", () => act("restart")]);
    if (gone.includes("recorder")) buttons.push(["Recover the recording", () => act("recover")]);
  }
  const failed = link.connected && now.mode === "live" && now.sources?.recorder?.lives && now.recorder?.state === "failed";
  if (failed) said = { ...said, text: `${said.text} Nothing is recorded: ${now.recorder.reason}.` };
  const bad = GRAVE.includes(said.word);
  const shown = buttons.length > 0 || bad || failed;
  byId("notice").hidden = !shown;
  byId("notice").classList.toggle("bad", bad);
  if (!shown) return false;
  const seen = said.word === "dead" && rig.age ? ` Last seen ${rig.age} s ago; what you see is from then.` : "";
  setText("notice-text", said.text + seen);
  const place = byId("notice-buttons"), names = buttons.map(([name]) => name).join();
  if (place.dataset.names === names) return true;
  place.dataset.names = names;
  place.replaceChildren(...buttons.map(([name, run]) => element("button", { textContent: name, onclick: run })));
  return true;
}

/** Show losses: as text while they are new, then as a count that leaves room for the sentence. */
function showLost() {
  const { words, at } = lastLost, isNew = words !== "" && (now.rig?.time ?? 0) - at < LOST_S;
  say("lost", now.lost ? (isNew ? words : words && `earlier: ${Object.values(now.lost)[0]}`) || "0" : "–", isNew);
  byId("lost").title = words;
}

const plain = (word) => String(word ?? "").replaceAll("_", " ");
const gapNow = () => (now.knobs?.["sphere.present"] ? now.knobs["barriers.gap_m"] : now.knobs ? 0 : null);

function showDt() {
  const rows = now.dt ?? [], present = now.dt_now ?? {};
  const settles = present.state === "settling" && !document.body.classList.contains("stale");
  const row = rows[rows.length - 1];
  const old = Boolean(row) && !holds(document.body.classList.contains("stale"), present);
  byId("dt-value").classList.toggle("old", old);
  const [value, u] = row && !settles ? withUncertainty(row.dt, row.u) : ["–", ""];
  setText("dt-number", value);
  setText("dt-u", u ? `${u} (2u)` : "");
  byId("settling").hidden = !settles;
  if (settles) {
    const done = present.done ?? 0, of = present.of ?? 8, quiet = present.quiet_of ? present.quiet / present.quiet_of : 1;
    byId("settling-bar").value = of ? Math.min(1, done / of, quiet) : 0;
    const rest = typeof present.rest === "number" ? `, transient ${fixed(100 * present.rest, 1)} %` : "";
    const windows = `settling: window ${fixed(done, 0)} of ${fixed(of, 0)}${rest}`;
    const sphere = `no impact for ${fixed(present.quiet ?? 0, 0)} s; ${present.reason}`;
    setText("settling-text", now.mode === "playback" ? "settling" : present.quiet_of ? sphere : windows);
  }
  const waits = settles && Boolean(present.quiet_of);
  const why = ["unable", "lost scans", "settling"].includes(plain(present.state)) && present.reason && !waits ? `not measured: ${present.reason}` : "";
  byId("dt-why").hidden = !(old || why);
  setText("dt-why", why || (old && !settles ? "the last value; it does not apply now" : ""));
  const none = row && row.ipc === 0 && row.gap ? "no impacts" : "";
  const without = row?.gap ? rows.findLast((one) => one.gap === 0 && one.settled && one.f === row.f) : undefined;
  const reduction = without ? `${fixed(100 * (1 - row.dt / without.dt), 1)} %` : row?.gap ? "not measured" : "";
  const more = row && !settles ? {
    [old ? "last, at" : "at"]: `${fixed(row.f, 3)} Hz`, phase: `${fixed(row.phase, 1)}°`, regime: none || row.regime,
    ...(reduction ? { "reduction": reduction } : {}),
    "impacts per cycle": fixed(row.ipc, 2), "|X₁|": `${fixed(row.x1 * 1e3, 3)} mm`, "|X_b|": `${fixed(row.xb * 1e6, 1)} µm`,
    ...(row.status ? { status: row.note || row.status } : {}),
  } : {};
  const list = byId("dt-more");
  const words = JSON.stringify(more);
  if (list.dataset.words !== words) {
    list.dataset.words = words;
    list.replaceChildren(...Object.entries(more).map((entry) => element("div", {}, ...explained(entry))));
  }
  setText("curve-note", rows.length ? "grey points: other gaps" : "No measurement yet: it appears when the response has settled.");
}

function showCurve() {
  curve.show(now.dt ?? [], now.closed_form ?? [], now.prediction?.lines ?? [], gapNow(), now.dt_b ?? []);
  setText("prediction-note", now.prediction?.words ?? "");
  byId("curve-back").hidden = curve.removed.size === 0;
  byId("curve-remove").disabled = byId("curve-csv").disabled = curve.rows.length === 0;
}

/** Explain every word shown in a tooltip. */
function explain() {
  const help = now.help ?? {};
  for (const node of document.querySelectorAll("#bar dt, #word, #dt-more dt, #dt-more dd, #dt-why, [data-help]")) {
    const label = /** @type {HTMLElement} */ (node);
    const word = (label.dataset.help ?? label.firstChild?.textContent ?? "").trim().replace(/^not measured: /, "");
    const text = help[word] ?? help[plain(word)];
    if (text && label.title !== text) label.title = text;
  }
  for (const id of ["knob-law", "fault-kind"]) {
    for (const option of byId(id).options) option.title = help[option.textContent] ?? "";
  }
}

/** A term with its explanation, for a list. */
const explained = ([name, text]) => [element("dt", { textContent: name }), element("dd", { textContent: text })];

function fillWords() {
  byId("sheet-words").replaceChildren(...Object.entries(now.help ?? {}).flatMap(explained));
}

function showJournal(all) {
  const list = byId("journal-list"), at = now.playback?.now ?? Infinity; // later entries have not happened yet
  const lines = (all ?? []).filter(([time]) => time <= at);
  if (list.dataset.shown === `${all?.length} ${lines.length}`) return;
  list.dataset.shown = `${all?.length} ${lines.length}`;
  const bottom = list.scrollHeight - list.scrollTop - list.clientHeight < 30;
  list.replaceChildren(...lines.slice(-120).map(([time, kind, key, words]) => {
    const item = element("li", {}, element("time", { textContent: clock(time) }),
      element("span", { className: "kind", textContent: plain(kind) }),
      element("span", { className: "what", textContent: `${kind === "parameter" ? key : plain(key)} ${words}`.trim() }));
    item.dataset.kind = kind;
    return item;
  }));
  if (bottom) list.scrollTop = list.scrollHeight;
}

// Drawing

const hurries = () => (now.rig?.speed ?? 1) > 1.5; // rig time runs faster than real time: the machine is needed for the rig

function frame(at) {
  if (hurries() && now.mode === "live" && slow.factor === 1) setTimeout(() => requestAnimationFrame(frame), now.rig?.motion === false ? 950 : 450);
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
    motion.clear(); // the last picture would look like the present
    setText("rig-note", `at × ${fixed(speed, 0)} the motion is too fast to follow and not drawn`);
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

// User actions

function faultSize() {
  const about = now.choices?.faults?.[byId("fault-kind").value];
  return about?.sizes[about.board ? "" : byId("fault-channel").value];
}

function showFault() {
  const about = now.choices?.faults?.[byId("fault-kind").value];
  if (!about) return;
  setText("fault-text", about.words);
  byId("fault-channel").disabled = about.board;
  byId("fault-rate-label").hidden = !about.rate;
  const size = faultSize();
  byId("fault-value-label").hidden = !size;
  setText("fault-value-name", size?.name ?? "");
  setText("fault-unit", size?.unit ?? "");
  byId("fault-value").value = String(size?.default ?? 0);
}

const token = new URLSearchParams(location.search).get("token") ?? "";
const chosenRuns = () => [.../** @type {NodeListOf<HTMLInputElement>} */ (document.querySelectorAll("#run-list input:checked"))].map((box) => box.value);

async function listRuns() {
  if (!byId("recorded").open) return;
  const runs = await (await fetch(`/runs?token=${encodeURIComponent(token)}`)).json();
  byId("run-list").replaceChildren(...runs.map(({ name, megabytes }) => {
    const box = element("input", { type: "checkbox", value: name });
    box.addEventListener("change", () => { byId("run-play").disabled = ![1, 2].includes(chosenRuns().length); });
    return element("li", {}, element("label", {}, box, ` ${name} `, `(${megabytes} MB)`));
  }));
  if (!runs.length) byId("run-list").textContent = "none yet";
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
  showPlayer();
}

const run = async () => (await knobs.turn("frequency", 9.1)) && knobs.turn("current", 0.52);
const rest = () => knobs.turn("current", 0);
const pause = () => (now.mode === "playback" ? player.toggle() : act("pause", { value: now.rig?.word !== "paused" }));
const record = () => act("record", { value: !(now.recorder?.lives && now.recorder.name) });
const sheet = () => { if (byId("sheet").open) byId("sheet").close(); else byId("sheet").show(); }; // not modal: STOP stays accessible
const removeLast = () => { curve.remove(curve.rows[curve.rows.length - 1]); showCurve(); };
const switchTheme = () => theme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
const live = (deed) => () => { if (now.mode === "live") deed(); };
const focus = (id) => () => byId(id).focus();
const bindings = [
  { keys: ["Escape"], text: "STOP: ramp the current to zero and latch the shaker, in any state", run: () => { byId("sheet").close(); if (now.mode === "live") act("stop"); } },
  { keys: ["r", "R"], text: "run: 9.1 Hz, 0.52 A", run: live(run) },
  { keys: ["0"], text: "rest: set the current to zero", run: live(rest) },
  { keys: [" "], text: "pause or resume rig time; in playback, play or pause", run: pause },
  { keys: ["c", "C"], text: "clear the trip, so that the shaker accepts commands again", run: live(() => act("clear_trip")) },
  { keys: ["z", "Z"], text: "reset: start again at scan 0", run: live(() => act("reset")) },
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
  { keys: ["h", "H"], text: "hold the picture of the scope, or continue it", run: () => byId("hold").click() },
  { keys: ["ArrowLeft"], text: "playback: 5 s back", run: () => player.jump(-5) },
  { keys: ["ArrowRight"], text: "playback: 5 s forward", run: () => player.jump(5) },
  { keys: ["."], text: "playback: next impact", run: () => now.playback && act("next_impact", { value: 1 }) },
  { keys: [","], text: "playback: previous impact", run: () => now.playback && act("next_impact", { value: -1 }) },
  { keys: ["Delete"], text: "remove the newest point of the curve", run: removeLast },
  { keys: ["t", "T"], text: "dark or light", run: switchTheme },
  { keys: ["?"], text: "open and close this sheet", run: sheet },
];
fillSheet(byId("sheet-keys"), bindings);
listen(bindings);

const onClick = (id, deed) => byId(id).addEventListener("click", deed);
for (const [id, what] of [["stop", "stop"], ["reset", "reset"], ["clear", "clear_trip"], ["sweep-stop", "sweep_stop"], ["fault-clear", "clear_faults"]]) {
  onClick(id, () => act(what));
}
onClick("theme", switchTheme);
onClick("help", sheet);
onClick("curve-remove", removeLast);
onClick("curve-back", () => { curve.restore(now.dt ?? []); showCurve(); });
onClick("curve-csv", () => save(new Blob([curve.csv()], { type: "text/csv" }), "transmissibility.csv"));
onClick("curve-picture", () => savePicture(curve.picture(), "transmissibility.png"));
onClick("scope-picture", () => savePicture(scope.picture(), "scope.png"));
onClick("settings-save", () => save(new Blob([now.configuration ?? ""], { type: "application/yaml" }), "rig.yaml"));
onClick("settings-load", () => byId("settings-file").click());
byId("settings-file").addEventListener("change", async () => {
  const [file] = byId("settings-file").files;
  if (file) act("load", { value: await file.text() });
  byId("settings-file").value = "";
});
onClick("run", run);
onClick("rest", rest);
onClick("pause", pause);
onClick("pluck", () => act("pluck", { value: 0.002 }));
onClick("record", record);
const onSubmit = (id, deed) => byId(id).addEventListener("submit", (event) => { event.preventDefault(); deed(); });
new SweepForm(act);
onSubmit("fault-form", () => act("fault", {
  kind: byId("fault-kind").value, channel: byId("fault-channel").disabled ? "" : byId("fault-channel").value,
  value: byId("fault-value").valueAsNumber * (faultSize()?.scale ?? 1), duration: byId("fault-duration").valueAsNumber, rate: byId("fault-rate").valueAsNumber,
}));
onSubmit("note-form", () => {
  act("note", { value: byId("note").value });
  byId("note").value = "";
});
byId("recorded").addEventListener("toggle", listRuns);
onClick("run-play", () => {
  window.open(`/?${new URLSearchParams([["token", token], ...chosenRuns().map((name) => ["run", name])])}`, "_blank", "noopener");
});
for (const id of ["fault-kind", "fault-channel"]) byId(id).addEventListener("change", showFault);
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
