// State of the page: connection, snapshot, and knobs that wait for confirmation.

/** @typedef {"pending" | "refused" | "active"} KnobState */

/** States of the knobs: while a request waits for its answer, the field keeps the requested value, not the rig's old one. */
export class Knobs {
  constructor() {
    /** @type {Map<string, {state: KnobState, request: number, words: string}>} */
    this.all = new Map();
  }

  /** @param {string} name @param {number} request number of the request */
  ask(name, request) { this.all.set(name, { state: "pending", request, words: "" }); }

  /**
   * Process an answer; one to an older request of the same knob is ignored.
   * @param {string} name @param {number} request @param {boolean} ok @param {string} words
   */
  answer(name, request, ok, words) {
    const knob = this.all.get(name);
    if (!knob || knob.request !== request) return;
    this.all.set(name, { state: ok ? "active" : "refused", request, words: ok ? "" : words });
  }

  /** @param {string} name @returns {KnobState} */
  state(name) { return this.all.get(name)?.state ?? "active"; }

  /** @param {string} name @returns {string} reason of the rejection */
  words(name) { return this.all.get(name)?.words ?? ""; }

  /** @param {string} name @returns {boolean} whether the field may show the active value */
  follows(name) { return this.state(name) !== "pending"; }

  /** Forget the rejections, because the values may be accepted now. */
  forgive() {
    for (const [name, knob] of this.all) if (knob.state === "refused") this.all.delete(name);
  }

  /** Reject all pending requests, because the connection is lost. */
  lose() {
    for (const [name, knob] of this.all) {
      if (knob.state === "pending") this.all.set(name, { ...knob, state: "refused", words: "the connection was lost before the answer" });
    }
  }
}

const LAMPS = {
  "at rest": "○", driving: "◐", measured: "●", settling: "◔", tripped: "▲", paused: "❚❚", plucked: "∿", rival: "⚠",
  "no peer": "⚠", "silent peer": "⚠", inactive: "…", unknown: "?", dead: "✕", starting: "…", choose: "?",
  offline: "✕", playback: "▶", "paused playback": "❚❚",
};
const STALE = ["offline", "dead", "starting", "inactive", "choose"];
export const GRAVE = ["tripped", "dead", "rival", "silent peer", "no peer", "offline"];

/**
 * Content of the status bar: the connection has priority over the rig, so stale values are never shown as live.
 * @param {boolean} connected @param {{word?: string, text?: string, waits?: boolean} | undefined} rig
 * @returns {{word: string, text: string, lamp: string, stale: boolean}}
 */
export function status(connected, rig) {
  const word = connected ? rig?.word ?? "starting" : "offline";
  const text = connected ? rig?.text ?? "" : "The lab does not answer; reconnecting. The values shown are old.";
  return { word, text, lamp: LAMPS[word] ?? "○", stale: STALE.includes(word) || Boolean(rig?.waits) };
}

/**
 * Return whether a measurement applies now; without a live source it is old.
 * @param {boolean} stale whether rig or server are gone
 * @param {{holds?: boolean, state?: string} | undefined} present part `dt_now` of the snapshot
 * @returns {boolean}
 */
export function holds(stale, present) { return !stale && Boolean(present?.holds); }

/**
 * Seconds until the next attempt to connect.
 * @param {number} attempt 0 for the first
 * @returns {number}
 */
export function patience(attempt) { return Math.min(5, 0.3 * 1.7 ** attempt); }
