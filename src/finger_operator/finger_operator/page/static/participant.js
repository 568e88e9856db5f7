// The participant's view: the cue, and before a press what will come.
import { Link, draw, whenShown } from "./cue.js";
import { liftTone, muteButton } from "./sound.js";

const WORDS = {
  idle: "Please wait", prepare: "Please wait", moisture_before: "Moisture",
  moisture_after: "Moisture", done: "Thank you", failed: "Once more", paused: "Break",
};
const TEXTS = {
  moisture_before: "The probe is held to your fingertip. Keep still.",
  moisture_after: "The probe is held to your fingertip. Keep still.",
  pull: "Keep the force, and pull your finger sideways, evenly.",
  paused: "You may rest. It goes on when the operator is ready.",
  failed: "That was not your fault. The press is done again.",
};

function show(phase, preparation = "") {
  draw(phase, WORDS[phase]);
  const how = phase === "idle" || phase === "prepare";
  document.getElementById("how").hidden = !how;
  document.getElementById("cue-text").textContent =
    phase === "prepare" ? preparation : TEXTS[phase] || "";
}

let newest = null;
new Link({ view: "participant" }, (data) => {
  if (typeof data !== "string") return;
  const message = JSON.parse(data);
  if (message.type !== "cue") return;
  show(message.phase, message.preparation);
  newest = message;
  if (message.phase !== "lift" || message.id < 0) return;
  // A hidden page has no frames: its tone comes at once, and none comes late.
  if (document.hidden) liftTone();
  else whenShown(() => { if (newest === message) liftTone(); });
}, (now) => {
  if (now === "lost") newest = null;
  if (now === "open" && newest) show(newest.phase, newest.preparation);
  else show("idle");
});

show("idle");
muteButton(document.getElementById("sound"), "off");
document.addEventListener("keydown", (event) => {
  if (event.key.toLowerCase() === "f") document.documentElement.requestFullscreen?.();
});
