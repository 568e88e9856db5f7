// The tone at the cue to lift. Browsers allow sound only after a key or a click on the page.

let context = null;
let key = "tone";
let on = true;

function ready() {
  context ??= new AudioContext();
  if (context.state === "suspended") context.resume();
}
for (const kind of ["keydown", "pointerdown"]) addEventListener(kind, ready, { passive: true });

export function tone() {
  if (!context) return false;
  const gain = new GainNode(context, { gain: 0 });
  const source = new OscillatorNode(context, { frequency: 880 });
  const now = context.currentTime;
  gain.gain.setValueAtTime(0, now);
  gain.gain.linearRampToValueAtTime(0.4, now + 0.01);
  gain.gain.setValueAtTime(0.4, now + 0.25);
  gain.gain.linearRampToValueAtTime(0, now + 0.3);
  source.connect(gain).connect(context.destination);
  source.start(now);
  source.stop(now + 0.32);
  return true;
}

export const liftTone = () => on && tone();

// A button that mutes; the choice is kept for this browser and view.
export function muteButton(button, usual = "on") {
  key = `tone ${location.pathname}`;
  on = (localStorage.getItem(key) ?? usual) === "on";
  const show = () => {
    button.setAttribute("aria-pressed", String(on));
    button.textContent = on ? "Tone on" : "Tone off";
  };
  button.onclick = () => {
    on = !on;
    localStorage.setItem(key, on ? "on" : "off");
    show();
    if (on) { ready(); tone(); }
  };
  show();
}
