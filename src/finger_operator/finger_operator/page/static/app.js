// The operator's page. State comes over one WebSocket; every command goes back over it, with the
// page's token.
import { Charts } from "./charts.js";
import { Link, SILENT, draw, whenShown } from "./cue.js";
import { ask, newSession, write } from "./dialogs.js";
import { RUNNING, showHealth, showLog, showTrials, tabs } from "./lists.js";
import { liftTone, muteButton, tone } from "./sound.js";

const $ = (id) => document.getElementById(id);
const token = document.querySelector("meta[name=token]").content;
// s from which a value is too old to stand on the page.
const OLD = 0.7;
const FRAMES = 400;

const state = {
  status: { step: "closed" }, cue: null, answers: new Map(), number: 0,
  area: { area: null, doubt: "" }, estimate: { contact: false, known: false, doubt: "" },
  link: "lost", aliveAt: -Infinity, away: true,
  alive: { ages: {}, problems: [], tared: null, probe: "" },
  images: null, imageAt: -Infinity, frames: [], pressFrames: [],
};
const charts = new Charts((time) => { showFrame(time); showNumbers(); });
// Time (ms) until which nothing but the cue is drawn.
let drawn = 0;
let plotted = 0;

function set(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

// Commands ------------------------------------------------------------------------------------

function command(name, args = {}, quiet = false) {
  const id = ++state.number;
  return new Promise((resolve) => {
    state.answers.set(id, resolve);
    if (!link.send({ type: "command", name, arguments: args, token, id })) {
      state.answers.delete(id);
      resolve({ success: false, message: "not connected" });
    }
  }).then((answer) => {
    if (!quiet || !answer.success) notify(answer.message || `${name}: done`, answer.success);
    return answer;
  });
}

let forget = 0;
function notify(text, good) {
  const place = $("answer");
  place.textContent = text;
  place.className = good ? "good" : "bad";
  clearTimeout(forget);
  forget = setTimeout(() => { place.textContent = ""; place.className = ""; }, good ? 6e3 : 15e3);
}

// A double click is one click, and so are two taps of a key: the second one would already mean the
// next step, such as to begin a trial that nobody has prepared.
const TWICE = 500;
function once(action) {
  let last = -Infinity;
  return (...args) => {
    const now = performance.now();
    if (now - last < TWICE) return;
    last = now;
    action(...args);
  };
}

// What the operator sees now: a command for it is refused when something else has begun meanwhile.
function seen() {
  const { step, index, session } = state.status;
  return index === undefined ? { seen_step: step }
    : { seen_trial: index, seen_step: step, seen_session: session };
}

// For commands that mean the trial, or the session, at whichever step it is.
const seenTrial = () => ({ ...seen(), seen_step: undefined });
const seenSession = () => ({ seen_session: state.status.session });

function primary() {
  const { step, paused } = state.status;
  if (step === "closed") return openSession();
  if (paused) return command("resume", seen());
  if (step === "finished") return command("close", seen());
  return command("start", seen());
}

// What Space does when the button may not be pressed: it says why; the banner says what to do.
function whyNot() {
  const [first] = state.alive.problems;
  if (state.away) return notify("Not connected to the rig.", false);
  if (first && blocked()) notify(`Not ready: ${first.text}`, false);
}

const resumable = () => state.status.paused
  || (state.status.step === "finished" && Boolean(state.status.ended));

function openSession() {
  if (!state.status.plan) return notify("The protocol node is not running.", false);
  const shown = seen();
  newSession(state.status, async (plan, calibrate) => {
    const answer = await command("configure", plan, true);
    if (!answer.success) return answer;
    return command(calibrate ? "calibrate" : "start", { ...shown, for_subject: plan.subject });
  }, (given) => Promise.all([
    command("order", given, true),
    command("new_conditions", { conditions: given.conditions }, true),
  ]));
}

const repeat = once((index) => command("repeat", { index, ...seen() }));

async function skip() {
  const { index, condition } = state.status;
  const shown = seen();
  const chosen = await ask(`Skip trial ${index + 1} (${condition})?`,
    "It is left out. Until the session is closed it can be repeated from the list.",
    [["skip", "Skip the trial"]]);
  if (chosen) command("skip", shown);
}

// As far back as the log is shown.
function lastKept({ events = [], trials = [] }) {
  const kept = [...events].reverse().find(
    (e) => e.kind === "kept" && trials[e.index]?.verdict === "done");
  return kept && trials[kept.index];
}

async function redo() {
  const { step, index, attempt } = state.status;
  const shown = seen();
  const last = lastKept(state.status);
  // Of a trial that begins again already there is nothing to ask: the answer says so.
  if (!RUNNING.includes(step) && step !== "failed" && !(step === "prepare" && attempt)) {
    const which = last ? `, ${last.index + 1} (${last.condition})` : "";
    const chosen = await ask(`Redo the last kept trial${which}?`,
      `Its attempt no longer counts; the bag stays. Now: trial ${index + 1}.`,
      [["redo", "Redo the trial"]]);
    if (!chosen) return;
    if (last) return command("repeat", { index: last.index, ...shown });
  }
  command("redo", shown);
}

async function end() {
  const open = (state.status.trials || []).filter((t) => t.verdict === "pending").length;
  const running = RUNNING.includes(state.status.step);
  const shown = seenTrial();
  const chosen = await ask("End the session?",
    `${open} ${open === 1 ? "trial is" : "trials are"} not done. All data are kept.`,
    running ? [["end", "End after this trial"], ["abort", "Abort this trial and end"]]
      : [["end", "End the session"]]);
  if (chosen) command(chosen, shown);
}

function note() {
  const { trials = [], index, step } = state.status;
  const begun = trials.filter((t) => t.attempts);
  const choices = [[0, "the session"], ...begun.map((t) => [t.index + 1, `trial ${t.index + 1}`])];
  const newest = RUNNING.includes(step) || step === "done" || step === "failed";
  const chosen = newest && begun.some((t) => t.index === index) ? index + 1
    : begun.length ? begun[begun.length - 1].index + 1 : 0;
  const shown = seenSession();
  write("Note", "", choices, chosen, (text, trial) => command("note", { text, trial, ...shown }));
}

function editPreparation() {
  const { condition, preparation } = state.status;
  const shown = seenSession();
  write(`Preparation: ${condition}`, preparation || "", [], 0,
    (text) => command("preparation", { condition, text, ...shown }));
}

async function tare() {
  const answer = await command("tare");
  if (answer.success && state.status.step !== "press") charts.forget();
}

// Cue -----------------------------------------------------------------------------------------

const PRESSING = ["press", "pull", "lift"];

function showCue(message) {
  const began = message.phase === "press" && (!state.cue || state.cue.phase !== message.phase);
  state.cue = message;
  drawCue();
  // The frame that carries the cue carries nothing else that takes time to draw.
  drawn = performance.now() + 80 + PERIOD;
  if (!document.hidden) waiting ??= [];
  const seen = !document.hidden;
  const shown = () => {
    // A frame may come long after, when the page was hidden meanwhile.
    if (message.id >= 0 && state.cue === message) {
      if (seen) link.send({ type: "shown", id: message.id });
      if (message.phase === "lift") liftTone();
    }
    goOn();
  };
  if (seen) whenShown(shown);
  else shown();
  if (began) {
    charts.pressBegins(message.index, message.time);
    state.frames = [];
  } else if (!PRESSING.includes(message.phase) && charts.press) {
    charts.pressEnds(message.time);
    state.pressFrames = state.frames.slice();
  }
}

function cueName() {
  const s = state.status;
  if (state.away || missing("protocol")) return "offline";
  if (s.step === "closed") return "closed";
  if (s.paused) return "paused";
  const name = state.cue ? state.cue.phase : "idle";
  // These are the cue's own; the finer steps come with the status.
  if (PRESSING.includes(name)) return name;
  if (["clear", "closing", "finished"].includes(s.step)) return s.step;
  // A trial is good when it is saved, not before.
  return name === "done" && s.step !== "done" ? "closing" : name;
}

function cueText(name) {
  const s = state.status;
  if (state.link === "refused") {
    return "This address is no longer valid. Open the page's new address from the rig's terminal.";
  }
  if (name === "offline") {
    return state.away ? "The page shows nothing until the rig answers again."
      : "Without the protocol there is no cue.";
  }
  // A calibration's press has words of its own, which come with the status.
  if (name === "press") return (s.step === name && s.instruction) || "Press until the cue changes.";
  if (name === "pull") return "Keep the force, and pull sideways until the cue changes.";
  if (name === "lift") return "Lift the finger.";
  if (name === "prepare" && s.step === name) return s.message ? s.instruction : s.preparation;
  const text = name === s.step || s.paused ? s.instruction || "" : "";
  // What is wrong with the probe matters while its readings are awaited.
  const { probe } = state.alive;
  return probe && READING.includes(name) ? `${text} Probe: ${probe}.` : text;
}

function drawCue() {
  const name = cueName();
  const word = name === "offline" && !state.away
    ? (missing("protocol").starting ? "Starting" : "No protocol") : undefined;
  draw(name, word);
  const text = cueText(name);
  set($("cue-text"), text);
  set($("prompt"), name === "prepare" ? state.status.prompt || "" : "");
  // One sentence for a screen reader, when it changes: no numbers that jitter.
  set($("say"), `${$("cue-word").textContent}. ${text}`);
  const banner = $("banner").hidden ? "" : $("banner").textContent.length;
  const content = [name, text, $("cue-trial").textContent, banner].join();
  if (content !== fitted) fit(content);
}

// What the cue's panel held when it was last made to fit.
let fitted = "";
function fit(content) {
  const cue = $("cue");
  fitted = content;
  for (const level of [0, 1, 2, 3, 4, 5]) {
    cue.dataset.fit = level;
    if (cue.scrollHeight <= cue.clientHeight + 1) return;
  }
}
new ResizeObserver(() => fit(fitted)).observe($("cue"));

// Status --------------------------------------------------------------------------------------

const LABELS = {
  closed: "New session", prepare: "Ready", idle: "Begin", finished: "Close session",
};

const missing = (source) => state.alive.problems.find((p) => p.source === source);

// Whether what is wrong keeps the next trial from beginning.
const blocked = () => state.status.step === "prepare" && !state.status.paused
  && state.alive.problems.length > 0;

function showStatus(s) {
  state.status = s;
  charts.target = s.target_force ?? s.plan?.target_force ?? charts.target;
  const open = s.step !== "closed";
  set($("session"), open ? s.session : "no session");
  const attempt = s.attempt ? ` · attempt ${s.attempt + 1}` : "";
  set($("cue-trial"), open && s.step !== "finished"
    ? `Trial ${s.index + 1} of ${s.trials.length} · ${s.condition}${attempt}` : "");
  set($("left"), left(s));
  const warnings = s.warnings || [];
  $("warnings").hidden = !warnings.length;
  set($("warnings"), warnings.join(" "));
  chips("moisture-before", s.moisture_before, s.readings, s.step === "moisture_before");
  chips("moisture-after", s.moisture_after, s.readings, s.step === "moisture_after");
  showTrials(s, repeat);
  showLog(s.events);
  showButtons();
  drawCue();
}

function showButtons() {
  const s = state.status;
  const gone = state.away || Boolean(missing("protocol"));
  const open = s.step !== "closed" && !gone;
  const running = RUNNING.includes(s.step);
  // A zero that is set to the force of a finger reads as lift-off.
  const pressing = PRESSING.includes(s.step) && state.alive.tared !== false;
  set($("start").querySelector("span"), s.paused ? "Resume" : LABELS[s.step] || "Next");
  set($("pause").querySelector("span"), resumable() ? "Resume" : "Pause");
  const off = {
    start: gone || blocked() || (running && !s.paused),
    pause: !open || s.step === "idle" || (s.step === "finished" && !s.ended),
    redo: !open || s.step === "closing",
    skip: !open || ["finished", "done", "closing", "idle"].includes(s.step),
    tare: state.away || pressing, note: !open, marker: !open, "preparation-edit": !open,
    end: !open || s.step === "finished",
  };
  for (const [id, value] of Object.entries(off)) $(id).disabled = value;
  for (const button of document.querySelectorAll("#trials .repeat")) {
    button.disabled = gone || running;
  }
  $("moisture-form").querySelector("button").disabled = state.away;
}

function left(s) {
  const parts = [];
  if (s.time_left) parts.push(`≈ ${Math.max(Math.round(s.time_left / 60), 1)} min left`);
  const disk = s.disk || {};
  if (disk.free_gb != null) {
    // The number of trials that fit matters once it is of the size of what is still to come.
    const open = (s.trials || []).filter((t) => t.verdict === "pending").length;
    const scarce = disk.trials_left != null && disk.trials_left < 3 * open;
    parts.push(`${disk.free_gb} GB free${scarce ? ` (${disk.trials_left} trials)` : ""}`);
  }
  return parts.join(" · ");
}

// The status takes long to draw and may arrive before the cue: the cue is drawn first.
let soon = 0;
function showStatusSoon(s) {
  clearTimeout(soon);
  soon = setTimeout(() => (waiting ? showStatusSoon(s) : showStatus(s)), 60);
}

function chips(id, values = [], wanted = 3, now = false) {
  const place = $(id);
  const count = Math.max(wanted, values.length) + 1;
  while (place.children.length > count) place.lastChild.remove();
  while (place.children.length < count) place.append(document.createElement("span"));
  [...place.children].forEach((chip, i) => {
    if (i === count - 1) {
      chip.className = "mean";
      const mean = values.reduce((a, b) => a + b, 0) / values.length;
      set(chip, values.length > 1 ? `mean ${mean.toFixed(1)}` : "");
    } else {
      const full = i < values.length;
      chip.className = full ? "chip full" : now && i === values.length ? "chip next" : "chip";
      set(chip, full ? values[i].toFixed(1) : "–");
    }
  });
}

const READING = ["moisture_before", "moisture_after"];

// The cue comes before the status, and is over before it: either may be behind the reading.
const awaitsReading = () => !state.status.paused
  && (READING.includes(state.status.step) || READING.includes(cueName()));

// A reading that does not count is seen too, else the operator looks for the fault in the probe.
const READING_SHOWN = 1e4;
let readingShown = 0;
function showReading({ value, time }) {
  // A browser that has just come is told of the newest one, which may be old.
  if (!(state.alive.time - time < READING_SHOWN / 1e3)) return;
  const place = $("moisture-newest");
  const counts = awaitsReading();
  place.classList.toggle("bad", !counts);
  set(place, `${value.toFixed(1)}${counts ? "" : ", does not count now"}`);
  clearTimeout(readingShown);
  readingShown = setTimeout(() => set(place, ""), READING_SHOWN);
}

// What is fresh -------------------------------------------------------------------------------

const seconds = (age) => (age < 10 ? age.toFixed(1) : age.toFixed(0));

function check() {
  const now = performance.now();
  const away = state.link !== "open" || now - state.aliveAt > SILENT;
  const changed = away !== state.away;
  state.away = away;
  set($("link-word"), away ? "not connected" : "connected");
  $("link").className = away ? "bad" : "good";
  document.body.classList.toggle("offline", away);
  showProblems(away ? 0 : (now - state.aliveAt) / 1e3);
  if (changed) showButtons();
  drawCue();
  showNumbers();
  if (charts.mode === "live" && now - state.imageAt > SILENT) hideImage(now);
}
setInterval(check, 200);

function showProblems(since) {
  const problems = state.away ? [] : state.alive.problems;
  const [first, ...others] = problems;
  $("banner").hidden = !first;
  $("banner").classList.toggle("starting", Boolean(first?.starting));
  let alarm = state.away ? "Not connected to the rig." : "";
  if (first) {
    const age = first.age === null ? "" : ` Silent for ${seconds(first.age + since)}\u00a0s.`;
    set($("banner-text"), `${first.text}${age}`);
    const more = others.length
      ? ` And ${others.length} more: ${others.map((p) => p.text).join(" ")}` : "";
    set($("banner-remedy"), first.remedy + more);
    set($("banner-detail"), first.detail);
    alarm = problems.map((p) => p.text).join(" ") + ` ${first.remedy}`;
  }
  set($("alarm"), alarm);
}

function showAlive(message) {
  state.aliveAt = performance.now();
  state.alive = message;
  charts.setClock(message.time);
  check();
  showButtons();
}

const age = (kind) => {
  const last = state.alive.ages[kind];
  return last == null ? null : last + (performance.now() - state.aliveAt) / 1e3;
};
const fresh = (kind) => !state.away && age(kind) !== null && age(kind) < OLD;

function showNumber(id, unit, kind, text) {
  const place = $(id);
  const good = charts.mode !== "live" || charts.hover !== null || fresh(kind);
  set(place, good ? text : "–");
  place.classList.toggle("old", !good);
  const old = state.away ? "not connected" : age(kind) === null ? "none yet"
    : `none for ${seconds(age(kind))} s`;
  set(place.nextElementSibling, good ? unit : old);
}

// Why a value is doubtful, where one that is fresh stands there.
function showDoubt(id, kind, doubt) {
  const live = charts.mode === "live" && charts.hover === null;
  $(id).hidden = !(live && doubt && fresh(kind));
  set($(id), doubt);
}

function showNumbers() {
  const { force, measured, model } = charts.at();
  const live = charts.mode === "live" && charts.hover === null;
  const shown = force && Math.abs(force[1]) < 0.005 ? 0 : force?.[1];
  const untared = live && state.alive.tared === false;
  showNumber("force-value", untared ? "N, not tared" : "N", "force",
    force ? shown.toFixed(2).replace("-", "−") : "–");
  $("force-value").classList.toggle("untared", untared);
  const area = live ? state.area.area : measured?.[2];
  showNumber("area-value", "mm²", "area", area == null ? "–" : area.toFixed(1));
  showDoubt("area-flag", "area", state.area.doubt);
  showDoubt("estimate-flag", "model", state.estimate.doubt);
  // Without contact there is no estimate to draw: its area is zero, where the model tells it.
  const { contact: touching, known } = state.estimate;
  const recent = known && touching && force && model && force[0] - model[0] < 0.3;
  const contact = model && !untared && (!live || recent);
  const zero = live && known && !touching && !untared ? "0.0" : "–";
  showNumber("estimate-value", "mm²", "model", contact ? Charts.estimate(model) : zero);
  const third = contact ? Charts.third(charts.third, model) : "";
  const unit = { loop: "", indentation: "mm", pressure: "kPa" }[charts.third];
  if (charts.third === "loop") { set($("third-value"), ""); set($("third-unit"), ""); } else {
    showNumber("third-value", unit, "model", third || "–");
  }
  const share = fresh("force") && shown !== undefined && !untared
    ? Math.max(0, Math.min(1, shown / (charts.target * 1.25))) : 0;
  $("cue-bar").style.setProperty("--share", share);
}

// Image ---------------------------------------------------------------------------------------

function showImage(buffer) {
  const time = Number(new DataView(buffer).getBigInt64(0, true)) / 1e9;
  const jpeg = new Uint8Array(buffer, 8);
  state.frames.push({ time, jpeg });
  if (state.frames.length > FRAMES) state.frames.splice(0, FRAMES / 4);
  state.imageAt = performance.now();
  newestImage = jpeg;
}

// Waits to be drawn with the curves.
let newestImage = null;

// A data URL: one of a blob waits for the browser's main process, twice for each image.
function putImage(jpeg) {
  const parts = [];
  for (let i = 0; i < jpeg.length; i += 8192) {
    parts.push(String.fromCharCode(...jpeg.subarray(i, i + 8192)));
  }
  $("image").src = `data:image/jpeg;base64,${btoa(parts.join(""))}`;
  $("image").hidden = false;
  $("image-none").hidden = true;
}

function hideImage(now) {
  $("image").hidden = true;
  $("image-none").hidden = false;
  const old = Number.isFinite(state.imageAt)
    ? `no image for ${seconds((now - state.imageAt) / 1e3)} s` : "no image yet";
  set($("image-none"), state.images === false ? "images stay on the rig's own computer" : old);
}

// The image at the cursor, when the curves stand still.
function showFrame(time) {
  if (charts.mode === "live" || time === null) return;
  const frames = charts.mode === "last" ? state.pressFrames : state.frames;
  let best = null;
  for (const frame of frames) {
    if (!best || Math.abs(frame.time - time) < Math.abs(best.time - time)) best = frame;
  }
  if (best && Math.abs(best.time - time) < 0.3) putImage(best.jpeg);
}

// The link ------------------------------------------------------------------------------------

// Messages held back until the frame with a cue is on the screen; null when there is none.
let waiting = null;

function goOn() {
  const messages = waiting || [];
  waiting = null;
  messages.forEach(receive);
}

function receive(data) {
  if (typeof data !== "string") return waiting ? waiting.push(data) : showImage(data);
  const m = JSON.parse(data);
  if (m.type === "cue") showCue(m);
  else if (waiting && m.type !== "answer") waiting.push(data);
  else if (m.type === "points") {
    for (const kind of ["force", "measured", "model"]) if (m[kind]) charts.add(kind, m[kind]);
  } else if (m.type === "alive") showAlive(m);
  else if (m.type === "contact") {
    state.area = m;
  } else if (m.type === "estimate") {
    state.estimate = m;
  } else if (m.type === "status") showStatusSoon(m);
  else if (m.type === "health") showHealth(m.items);
  else if (m.type === "moisture") showReading(m);
  else if (m.type === "curves") charts.restore(m);
  else if (m.type === "hello") {
    state.images = m.images;
    link.send({ type: "watch", images: m.images && !document.hidden });
    command("curves", {}, true);
  } else if (m.type === "answer") {
    const resolve = state.answers.get(m.id);
    state.answers.delete(m.id);
    if (resolve) resolve(m);
  }
}

const link = new Link({ view: "operator", token }, receive, (now) => {
  state.link = now;
  if (now === "lost") for (const [id, resolve] of state.answers) {
    state.answers.delete(id);
    resolve({ success: false, unknown: true, message: "the connection was lost" });
  }
  check();
});

document.addEventListener("visibilitychange", () => {
  // A hidden page shows no frame to wait for.
  if (document.hidden) goOn();
  if (state.images) link.send({ type: "watch", images: !document.hidden });
});

// Drawing -------------------------------------------------------------------------------------

// Ten pictures a second are enough for the eye. All that moves is drawn together, so that the
// browser makes ten frames a second and is free for the cue, which waits for none of them.
const PERIOD = 95;

// Just before the cue to lift, plots and images wait, for half a second at most: one that is being
// drawn would hold the cue up.
function aboutToLift(now) {
  const force = charts.live.force.at(-1)?.[1] ?? 0;
  const pressing = state.cue && state.cue.phase === "press";
  return pressing && force > 0.8 * charts.target && now - plotted < 500;
}

function drawAll() {
  const now = performance.now();
  if (document.hidden || charts.mode !== "live" || now < drawn) return;
  showNumbers();
  if (aboutToLift(now)) return;
  plotted = now;
  charts.draw();
  if (newestImage) putImage(newestImage);
  newestImage = null;
}
setInterval(drawAll, PERIOD);

// Buttons and keys ----------------------------------------------------------------------------

$("start").onclick = once(() => primary());
$("pause").onclick = once(
  () => (resumable() ? command("resume", seen()) : command("pause", seenTrial())),
);
$("redo").onclick = once(() => redo());
$("skip").onclick = skip;
$("tare").onclick = once(() => tare());
$("note").onclick = note;
$("marker").onclick = once(() => command("marker", seenSession()));
$("end").onclick = end;
$("preparation-edit").onclick = editPreparation;
$("keys").onclick = () => $("keys-dialog").showModal();
$("tone-test").onclick = () => { if (!tone()) notify("This browser gives no sound.", false); };
muteButton($("sound"));
tabs(document.querySelector("[role=tablist]"));
$("live").onclick = () => charts.show("live");
$("freeze").onclick = () => charts.show("frozen");
$("last").onclick = () => charts.show("last");
$("zoom-out").onclick = () => charts.zoomOut();
$("scrub").oninput = () => charts.scrub(Number($("scrub").value));
$("third").onchange = () => {
  charts.third = $("third").value;
  charts.buildThird();
  charts.draw();
  showNumbers();
};
// A reading counts once, however often Enter is pressed for it, and on however many pages it is
// typed: it is refused when another one has come since its first digit.
let entering = false;
const readingsSeen = () => READING.flatMap((step) => state.status[step] ?? []).length;
let typedAfter = null;
$("moisture-input").oninput = ({ target }) => {
  typedAfter = target.value === "" ? null : typedAfter ?? readingsSeen();
};
$("moisture-form").onsubmit = async (event) => {
  event.preventDefault();
  const input = $("moisture-input");
  if (entering) return;
  if (input.value === "") {
    return notify(`Type a reading of ${input.placeholder} a.u. first.`, false);
  }
  entering = true;
  const seen_readings = typedAfter ?? readingsSeen();
  const value = Number(input.value);
  const answer = await command("moisture", { value, ...seen(), seen_readings });
  // Where nobody knows what became of it, Enter for it again must not be a second reading.
  typedAfter = answer.unknown ? seen_readings : null;
  if (answer.success) { input.value = ""; input.blur(); }
  setTimeout(() => { entering = false; }, TWICE);
};

const KEYS = {
  " ": () => ($("start").disabled ? whyNot() : $("start").click()),
  p: () => $("pause").click(),
  r: () => $("redo").click(),
  s: () => $("skip").click(),
  t: () => $("tare").click(),
  n: () => $("note").click(),
  k: () => $("marker").click(),
  x: () => $("end").click(),
  m: () => $("moisture-input").focus(),
  e: () => $("preparation-edit").click(),
  a: () => $("sound").click(),
  "?": () => $("keys").click(),
  f: () => document.documentElement.requestFullscreen?.(),
};
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  if (document.querySelector("dialog[open]")) return;
  // Until the next frame the focus may still be in a dialog that has just closed.
  const at = event.target.closest("dialog") ? document.body : event.target;
  if (at.closest("input, textarea, select")) {
    if (event.key === "Escape") at.blur();
    return;
  }
  // A focused button, link or row takes Space itself.
  if (event.key === " " && at.closest("button, a, summary")) return;
  const action = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!action || event.repeat) return;
  event.preventDefault();
  action();
});
// After a click with a pointer the focus goes back to the page, and Space to the main button.
document.addEventListener("click", (event) => {
  const button = event.target.closest("button, a");
  if (event.detail > 0 && button && !button.closest("dialog")) button.blur();
});
