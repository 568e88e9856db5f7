// The cue, shared by the operator's page and the participant's view: word, shape and colour.

const ARROWS = {
  press: "M40 8h20v46h22L50 92 18 54h22z",
  lift: "M40 92h20V46h22L50 8 18 46h22z",
  done: "M14 54l12-12 18 18 42-42 12 12-54 54z",
  failed: "M20 32L32 20l18 18 18-18 12 12-18 18 18 18-12 12-18-18-18 18-12-12 18-18z",
  paused: "M26 18h18v64H26zM56 18h18v64H56z",
};

const WORDS = {
  idle: "Ready", prepare: "Prepare", moisture_before: "Moisture", press: "Press", lift: "Lift",
  moisture_after: "Moisture", done: "Good", failed: "Again", paused: "Paused", clear: "Wait",
  closing: "Saving", finished: "Finished", closed: "No session",
};

export function draw(name, word) {
  const cue = document.getElementById("cue");
  if (cue.dataset.look !== name) {
    cue.dataset.look = name;
    const arrow = ARROWS[name] || "";
    document.getElementById("cue-arrow").setAttribute("d", arrow);
    document.querySelector("#cue svg").toggleAttribute("hidden", !arrow);
  }
  const element = document.getElementById("cue-word");
  const text = word || WORDS[name] || name;
  if (element.textContent !== text) element.textContent = text;
}

// After the frame that carries the cue was handed to the screen.
export function whenShown(callback) {
  requestAnimationFrame(() => {
    const channel = new MessageChannel();
    channel.port1.onmessage = callback;
    channel.port2.postMessage(0);
  });
}

// A socket that connects again by itself.
export class Link {
  constructor(view, receive, state) {
    this.view = new URLSearchParams(view);
    this.receive = receive;
    this.state = state;
    this.delay = 250;
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws?${this.view}`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => { this.delay = 250; this.state(true); };
    socket.onmessage = (event) => this.receive(event.data);
    socket.onclose = () => {
      this.state(false);
      setTimeout(() => this.open(), this.delay);
      this.delay = Math.min(this.delay * 2, 4000);
    };
    this.socket = socket;
  }

  send(message) {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }
}
