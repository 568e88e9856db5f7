import { Link, draw } from "./cue.js";

const words = {
  idle: "Please wait", prepare: "Please wait", moisture_before: "Moisture",
  moisture_after: "Moisture", done: "Thank you", failed: "Once more", paused: "Break",
};

new Link({ view: "participant" }, (data) => {
  if (typeof data !== "string") return;
  const message = JSON.parse(data);
  if (message.type !== "cue") return;
  draw(message.phase, words[message.phase]);
}, (connected) => {
  if (!connected) draw("idle", "Please wait");
});

document.addEventListener("keydown", (event) => {
  if (event.key.toLowerCase() === "f") document.documentElement.requestFullscreen?.();
});
