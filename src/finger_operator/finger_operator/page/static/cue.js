// The cue, shared by the operator's page and the participant's view: word, shape and colour.

const ARROWS = {
  press: "M40 8h20v46h22L50 92 18 54h22z",
  pull: "M8 40h46V18l38 32-38 32V60H8z",
  lift: "M40 92h20V46h22L50 8 18 46h22z",
  done: "M14 54l12-12 18 18 42-42 12 12-54 54z",
  failed: "M20 32L32 20l18 18 18-18 12 12-18 18 18 18-12 12-18-18-18 18-12-12 18-18z",
  paused: "M26 18h18v64H26zM56 18h18v64H56z",
};

const WORDS = {
  idle: "Ready", prepare: "Prepare", moisture_before: "Moisture", press: "Press",
  pull: "Pull", lift: "Lift",
  moisture_after: "Moisture", done: "Good", failed: "Again", paused: "Paused", clear: "Wait",
  closing: "Saving", finished: "Finished", closed: "No session", offline: "Not connected",
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

// The token of the page as it is served now, null when this address is refused; undefined when
// nobody answers. A rig that was started again has another one.
async function servedToken() {
  try {
    const answer = await fetch(location.href, { cache: "no-store" });
    if (!answer.ok) return null;
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    return page.querySelector("meta[name=token]")?.content ?? "";
  } catch {
    return undefined;
  }
}

// ms of silence from which what a page shows may be old, and from which its socket is given up: one
// whose other end is gone stays open for minutes.
export const SILENT = 1000;
const DEAD = 5000;

// A socket that connects again by itself, and reloads the page of a rig that was started again.
// state: called with "open", "silent", "lost" or "refused".
export class Link {
  constructor(view, receive, state) {
    this.view = new URLSearchParams(view);
    this.receive = receive;
    this.state = state;
    this.delay = 250;
    this.open();
    setInterval(() => this.listen(), 200);
  }

  listen() {
    const silence = performance.now() - this.heard;
    if (!this.socket) return;
    if (silence > DEAD) this.drop();
    else if (silence > SILENT && this.now === "open") this.say("silent");
  }

  say(now) {
    this.now = now;
    this.state(now);
  }

  // Without the closing handshake, which a dead connection does not answer.
  drop() {
    const socket = this.socket;
    this.socket = null;
    socket.onopen = socket.onmessage = socket.onclose = null;
    socket.close();
    this.say("lost");
    setTimeout(() => this.again(), this.delay);
    this.delay = Math.min(this.delay * 2, 2000);
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws?${this.view}`);
    socket.binaryType = "arraybuffer";
    const heard = () => {
      this.heard = performance.now();
      if (this.now !== "open") this.say("open");
    };
    this.heard = performance.now();
    socket.onopen = () => { this.delay = 250; heard(); };
    socket.onmessage = ({ data }) => {
      heard();
      // The server waits for this before it sends more, so that nothing old is on its way.
      if (typeof data === "string" && data.startsWith('{"type": "round"')) {
        this.send({ ...JSON.parse(data), type: "got" });
      } else this.receive(data);
    };
    socket.onclose = () => this.drop();
    this.socket = socket;
  }

  async again() {
    const token = await servedToken();
    const mine = this.view.get("token") ?? "";
    if (typeof token === "string" && token === mine) return this.open();
    if (typeof token === "string") return location.reload();
    if (token === null) this.say("refused");
    setTimeout(() => this.again(), this.delay);
    this.delay = Math.min(this.delay * 2, 2000);
  }

  send(message) {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }
}
