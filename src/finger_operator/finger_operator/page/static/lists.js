// The lists below the image: trials, devices, log. Rows are changed in place and never made anew,
// so that a focus or an open row stays where it is.

const $ = (id) => document.getElementById(id);
// Steps of a trial that is under way.
export const RUNNING = [
  "moisture_before", "clear", "press", "pull", "lift", "moisture_after", "closing",
];
const MARK = { done: "✓", skipped: "↷", pending: "", failed: "✗" };
const LEVELS = [["ok", "✓"], ["warn", "▲"], ["error", "✖"], ["stale", "◌"]];

function set(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function cell(row, kind = "td") {
  const made = document.createElement(kind);
  row.append(made);
  return made;
}

// Trials --------------------------------------------------------------------------------------

function trialRow(body, index, repeat) {
  const row = document.createElement("tr");
  row.dataset.index = index;
  for (let i = 0; i < 5; i++) cell(row);
  const again = document.createElement("button");
  again.className = "small repeat";
  again.textContent = "Repeat";
  again.setAttribute("aria-label", `Repeat trial ${index + 1}`);
  again.onclick = () => repeat(index);
  cell(row).append(again);
  const why = document.createElement("tr");
  why.className = "reason";
  why.dataset.index = index;
  cell(why);
  cell(why).colSpan = 5;
  body.append(row, why);
}

// The presses of a calibration without what all their names begin with.
const PRESS = /^calibration_/;
const shortName = (name) => (PRESS.test(name)
  ? name.replace(PRESS, "").replaceAll("_", " ") : name);

export function showTrials(s, repeat) {
  const trials = s.trials || [];
  const body = $("trials").querySelector("tbody");
  while (body.rows.length > 2 * trials.length) body.lastChild.remove();
  while (body.rows.length < 2 * trials.length) trialRow(body, body.rows.length / 2, repeat);
  for (const t of trials) {
    const row = body.rows[2 * t.index], why = body.rows[2 * t.index + 1];
    const here = t.index === s.index && s.step !== "finished";
    const failed = t.verdict === "pending" && t.reason;
    const verdict = failed ? "failed" : t.verdict;
    const next = t.attempts ? "repeat" : "";
    const word = { pending: here ? "now" : next, done: "kept" }[verdict] ?? verdict;
    row.dataset.verdict = verdict;
    row.className = here ? "here" : "";
    [t.index + 1, shortName(t.condition),
      `${MARK[verdict] || ""} ${word}${t.attempts > 1 ? ` (${t.attempts}\u00a0attempts)` : ""}`,
      t.time_to_target == null ? "" : `${t.time_to_target.toFixed(2)} s`,
      t.peak_force ? `${t.peak_force.toFixed(2)} N` : "",
    ].forEach((text, i) => set(row.cells[i], String(text).trim()));
    const again = row.cells[5].firstChild;
    again.hidden = t.verdict !== "done" && t.verdict !== "skipped";
    again.disabled = RUNNING.includes(s.step);
    const remarks = [...(t.notes || []), ...(t.markers || [])].map((r) => r.text);
    set(why.cells[1], [failed ? t.reason : "", ...remarks].filter(Boolean).join(" · "));
    why.className = `reason${here ? " here" : ""}${failed ? " failed" : ""}`;
    why.hidden = !why.cells[1].textContent;
  }
  const here = body.querySelector("tr.here");
  if (here && s.index !== showTrials.index) {
    showTrials.index = s.index;
    const box = body.closest(".scroll");
    box.scrollTop = here.offsetTop - box.clientHeight / 2;
  }
  showProgress(s, trials);
}

// More conditions than these leave no room in the header: the present one and all together then.
const CHIPS = 4;

function chipsOf(s, trials) {
  const part = (name, of) => ({ name, of, now: name === s.condition && s.step !== "finished" });
  const names = s.conditions || [];
  const parts = names.map((name) => part(name, trials.filter((t) => t.condition === name)));
  if (names.length <= CHIPS) return parts;
  return [...parts.filter((p) => p.now), part("all trials", trials)];
}

function showProgress(s, trials) {
  const list = $("progress");
  const parts = chipsOf(s, trials);
  while (list.children.length > parts.length) list.lastChild.remove();
  while (list.children.length < parts.length) {
    const item = document.createElement("li");
    item.append(document.createElement("span"), document.createElement("span"));
    item.firstChild.className = "name";
    list.append(item);
  }
  parts.forEach(({ name, of, now }, i) => {
    const closed = of.filter((t) => t.verdict !== "pending").length;
    const item = list.children[i];
    set(item.firstChild, name);
    set(item.lastChild, ` ${closed}/${of.length}`);
    item.title = name;
    item.className = now ? "now" : "";
    item.style.setProperty("--share", of.length ? closed / of.length : 0);
  });
}

// Devices -------------------------------------------------------------------------------------

const rows = new Map();

function deviceRow(name) {
  const row = document.createElement("li");
  const details = document.createElement("details");
  const summary = document.createElement("summary");
  const parts = {};
  for (const kind of ["mark", "name", "message"]) {
    parts[kind] = document.createElement("span");
    parts[kind].className = kind;
    summary.append(parts[kind]);
  }
  parts.name.textContent = name.replace(/^[^:]*\//, "").replace(/^(\w+): \1$/, "$1");
  const values = document.createElement("dl");
  details.append(summary, values);
  row.append(details);
  return { row, details, values, parts, terms: new Map() };
}

export function showHealth(items) {
  const list = $("health").querySelector("ul");
  items.forEach((item, i) => {
    if (!rows.has(item.name)) {
      rows.set(item.name, deviceRow(item.name));
      list.insertBefore(rows.get(item.name).row, list.children[i] || null);
    }
    const { row, details, values, parts, terms } = rows.get(item.name);
    const [level, mark] = LEVELS[item.level] || LEVELS[3];
    row.dataset.level = level;
    set(parts.mark, mark);
    const hertz = item.values.measured_rate_hz;
    const rate = hertz >= 0.5 && level !== "stale" && !/\bHz\b/.test(item.message)
      ? ` · ${Number(hertz).toFixed(0)} Hz` : "";
    set(parts.message, item.message + rate);
    if (!details.open) return;
    for (const [key, value] of Object.entries(item.values)) {
      if (!terms.has(key)) {
        const dt = document.createElement("dt"), dd = document.createElement("dd");
        dt.textContent = key;
        values.append(dt, dd);
        terms.set(key, dd);
      }
      set(terms.get(key), value);
    }
  });
  const bad = items.filter((item) => item.level >= 2).length;
  set($("health-count"), bad ? ` (${bad} ✖)` : "");
}

// Log -----------------------------------------------------------------------------------------

// Steps whose own words say too little.
const STEPS = { clear: "waiting for a free plate", closing: "saving the trial" };

// Time of day, with the date where it is not today's.
function clock(date) {
  const today = date.toDateString() === new Date().toDateString();
  const time = date.toLocaleTimeString("en-GB");
  return today ? time : `${date.toLocaleDateString("en-CA")} ${time}`;
}

export function showLog(events) {
  const list = $("log").querySelector("ol");
  const newest = [...(events || [])].reverse();
  while (list.children.length > newest.length) list.lastChild.remove();
  while (list.children.length < newest.length) {
    const item = document.createElement("li");
    for (let i = 0; i < 3; i++) item.append(document.createElement("span"));
    list.append(item);
  }
  newest.forEach((event, i) => {
    const [time, what, text] = list.children[i].children;
    list.children[i].dataset.kind = event.kind;
    set(time, clock(new Date(event.time * 1e3)));
    set(what, event.index >= 0 ? `trial ${event.index + 1}` : "session");
    set(text, event.kind === "note" ? `note: ${event.text}`
      : (event.kind === "step" && STEPS[event.text]) || event.text);
  });
}

// Tabs ----------------------------------------------------------------------------------------

export function tabs(list) {
  const all = [...list.querySelectorAll("[role=tab]")];
  const choose = (tab) => all.forEach((other) => {
    other.setAttribute("aria-selected", String(other === tab));
    other.tabIndex = other === tab ? 0 : -1;
    $(other.getAttribute("aria-controls")).hidden = other !== tab;
  });
  all.forEach((tab, i) => {
    tab.onclick = () => choose(tab);
    tab.onkeydown = (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (!step) return;
      event.preventDefault();
      const next = all[(i + step + all.length) % all.length];
      choose(next);
      next.focus();
    };
  });
}
