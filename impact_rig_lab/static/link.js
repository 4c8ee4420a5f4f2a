// The WebSocket: it reconnects forever, numbers requests, and returns answers to the callers.

import { decode, Kind } from "./frames.js";
import { patience } from "./store.js";

export class Link {
  /**
   * @param {(frame: {kind: number, number: number, content: any}) => void} onFrame
   * @param {(connected: boolean) => void} onChange
   */
  constructor(onFrame, onChange) {
    this.onFrame = onFrame;
    this.onChange = onChange;
    this.connected = false;
    this.attempt = 0;
    this.next = 1;
    /** @type {Map<number, (answer: {ok: boolean, text: string}) => void>} */
    this.waiting = new Map();
    this.view = null;
    /** @type {string | null} instance of the rig that the page shows; the lab rejects requests for another instance */
    this.rig = null;
    this.connect();
  }

  /** @private */
  connect() {
    const socket = new WebSocket(`ws://${location.host}/socket${location.search}`); // the token and the requested runs
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.connected = true;
      this.attempt = 0;
      if (this.view) socket.send(JSON.stringify({ do: "view", ...this.view }));
      this.onChange(true);
    };
    socket.onmessage = (event) => {
      const frame = decode(event.data);
      if (frame.kind === Kind.REPLY) {
        this.waiting.get(frame.content.id)?.(frame.content);
        this.waiting.delete(frame.content.id);
      } else this.onFrame(frame);
    };
    socket.onclose = () => {
      this.connected = false;
      for (const answer of this.waiting.values()) answer({ ok: false, text: "the connection was lost" });
      this.waiting.clear();
      this.onChange(false);
      setTimeout(() => this.connect(), 1000 * patience(this.attempt++));
    };
  }

  /**
   * Send a request.
   * @param {string} what @param {object} [values]
   * @returns {{id: number, answer: Promise<{ok: boolean, text: string}>}}
   */
  ask(what, values = {}) {
    const id = this.next++;
    if (this.socket.readyState !== WebSocket.OPEN) return { id, answer: Promise.resolve({ ok: false, text: "the lab does not answer" }) };
    this.send({ id, do: what, ...values, ...(this.rig === null ? {} : { rig: this.rig }) });
    return { id, answer: new Promise((resolve) => this.waiting.set(id, resolve)) };
  }

  /** @param {number} frame number of the drawn picture */
  acknowledge(frame) { this.send({ do: "ack", frame }); }

  /** @param {object} view settings of the scope */
  look(view) {
    this.view = view;
    this.send({ do: "view", ...view });
  }

  /** @private messages to a closing socket are lost and requested again later */
  send(request) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(request));
  }
}
