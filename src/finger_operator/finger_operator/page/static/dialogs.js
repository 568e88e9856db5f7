// Dialogs: a question before a step that cannot be undone, notes and texts, a new session.

const $ = (id) => document.getElementById(id);

// Ask; answers: [value, words] each. Resolves to a value, or null for Cancel, which has the focus.
export function ask(title, text, answers) {
  const dialog = $("ask-dialog");
  $("ask-title").textContent = title;
  $("ask-text").textContent = text;
  return new Promise((resolve) => {
    const button = (value, words) => {
      const element = document.createElement("button");
      element.textContent = words;
      element.onclick = () => { dialog.close(); resolve(value); };
      return element;
    };
    const cancel = button(null, "Cancel");
    $("ask-buttons").replaceChildren(...answers.map(([v, words]) => button(v, words)), cancel);
    // Escape. The event comes late: it may be that of a question before, answered just now.
    dialog.onclose = () => { if (!dialog.open) resolve(null); };
    dialog.showModal();
    cancel.focus();
  });
}

// Let a dialog's form be answered: send, once at a time, resolves to an answer of the server. The
// dialog closes when it was carried out; the sentence of a refusal is shown in `error`.
function submits(form, error, send) {
  let sending = false;
  form.onsubmit = async (event) => {
    event.preventDefault();
    if (sending) return;
    sending = true;
    error.textContent = "";
    const answer = await send(event.submitter);
    sending = false;
    if (answer.success) form.closest("dialog").close();
    else error.textContent = answer.message;
  };
}

// Write a text. trials: choices [value, words] of what it belongs to, or none. save: called with
// (text, choice), resolves to an answer of the server; its sentence is shown when it refuses.
export function write(title, text, trials, chosen, save) {
  const dialog = $("text-dialog");
  $("text-title").textContent = title;
  $("text-input").value = text;
  $("text-error").textContent = "";
  $("text-where").hidden = !trials.length;
  $("text-trial").replaceChildren(...trials.map(([value, words]) => new Option(words, value)));
  if (trials.length) $("text-trial").value = String(chosen);
  submits($("text-form"), $("text-error"),
    () => save($("text-input").value, Number($("text-trial").value)));
  $("text-cancel").onclick = () => dialog.close();
  dialog.showModal();
  $("text-input").focus();
}

const ORDERS = [
  ["as_given", "blocks as given"], ["shuffled_blocks", "blocks shuffled"],
  ["counterbalanced", "blocks counterbalanced over subjects"],
  ["shuffled_trials", "all trials shuffled"],
];

// As `alike` of finger_common.subject_code: S01, s01 and S1 may be one person.
const alike = (code) => code.toLowerCase().replace(/(^|\D)0+(?=\d)/g, "$1");

// Ask for a session. status: without a session. begin: called with the plan, and whether the
// subject is to be calibrated. tell: called with subject, conditions, order and seed, resolves to
// two answers of the server: what order they give, and which conditions may be misspelt.
export function newSession(status, begin, tell) {
  const { plan } = status;
  const used = status.used_subjects || {};
  const subject = $("plan-subject");
  const warn = () => {
    const code = subject.value.trim();
    $("subject-used").textContent = Object.keys(used).filter((c) => alike(c) === alike(code))
      .map((c) => `${c} was used before (${used[c].slice(-2).join(", ")}). ${c === code
        ? "Go on only if this is the same person."
        : `If this is the same person, write ${c}.`}`).join(" ");
  };
  const conditions = () => $("plan-conditions").value.split(",").map((c) => c.trim())
    .filter(Boolean);
  let asked = 0;
  const showConditions = async () => {
    const question = ++asked;
    const given = {
      subject: subject.value.trim(), conditions: conditions(),
      order: $("plan-order").value, order_seed: Number($("plan-seed").value) || 0,
    };
    const answers = given.conditions.length ? await tell(given) : [];
    if (question !== asked) return;
    ["plan-blocks", "plan-new"].forEach((id, i) => {
      $(id).textContent = answers[i]?.success ? answers[i].message : "";
    });
  };
  const number = (value) => (value ? String(value) : "");
  subject.value = plan.subject;
  // What was measured of one person is not the next one's.
  const own = ["plan-age", "plan-hand", "plan-finger", "plan-width", "plan-depth"];
  let untouched = true;
  own.forEach((id) => { $(id).oninput = () => { untouched = false; }; });
  subject.oninput = () => {
    if (untouched && subject.value.trim() !== plan.subject) {
      own.forEach((id) => { $(id).value = ""; });
    }
    warn();
    showConditions();
  };
  warn();
  $("plan-age").value = number(plan.age);
  $("plan-hand").value = plan.hand || "";
  $("plan-finger").value = plan.finger || "";
  $("plan-width").value = number(plan.finger_width && +(plan.finger_width * 1e3).toFixed(2));
  $("plan-depth").value = number(plan.finger_depth && +(plan.finger_depth * 1e3).toFixed(2));
  $("plan-conditions").value = plan.conditions.join(", ");
  $("plan-order").replaceChildren(...ORDERS.map(([value, words]) => new Option(words, value)));
  $("plan-order").value = plan.order || "as_given";
  $("plan-seed").value = plan.order_seed || 0;
  $("plan-trials").value = plan.trials;
  $("plan-readings").value = plan.readings;
  $("plan-target").value = plan.target_force;
  $("plan-error").textContent = "";
  ["plan-conditions", "plan-order", "plan-seed"].forEach((id) => {
    $(id).oninput = showConditions;
  });
  showConditions();
  submits($("session-form"), $("plan-error"), (submitter) => begin({
    subject: subject.value.trim(),
    age: Number($("plan-age").value),
    hand: $("plan-hand").value,
    finger: $("plan-finger").value,
    finger_width: Number($("plan-width").value) / 1e3,
    finger_depth: Number($("plan-depth").value) / 1e3,
    conditions: conditions(),
    trials: Number($("plan-trials").value),
    readings: Number($("plan-readings").value),
    target_force: Number($("plan-target").value),
    order: $("plan-order").value,
    order_seed: Number($("plan-seed").value),
  }, submitter?.value === "calibrate"));
  $("plan-cancel").onclick = () => $("session-dialog").close();
  $("session-dialog").showModal();
}
