// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// The socket that views come through: connects, connects again, and says when it is lost.

const WAITS = [500, 1000, 2000, 5000];
/** Silence [s] of a connected server, at least, after which what is shown counts for nothing. */
const PATIENCE = 2;

export class Live extends EventTarget {
  #attempt = 0;
  #lostAt = null;

  /** Begin; events are `hello`, `view`, `lost` and `connected`. */
  start() {
    const url = new URL('/live', location.href);
    url.protocol = url.protocol.replace('http', 'ws');
    this.#connect(url);
  }

  /** When the socket was lost, on the clock of `performance.now()`; null while it is open. */
  get lostAt() {
    return this.#lostAt;
  }

  #connect(url) {
    const socket = new WebSocket(url);
    socket.addEventListener('open', () => {
      this.#attempt = 0;
      this.#lostAt = null;
      this.dispatchEvent(new Event('connected'));
    });
    socket.addEventListener('message', ({data}) => {
      const message = JSON.parse(data);
      this.dispatchEvent(new CustomEvent(message.type, {detail: message}));
    });
    socket.addEventListener('close', () => {
      this.#lostAt ??= performance.now();
      this.dispatchEvent(new Event('lost'));
      setTimeout(() => this.#connect(url), WAITS[Math.min(this.#attempt, WAITS.length - 1)]);
      this.#attempt += 1;
    });
  }
}

/** Return the silence [s] after which views that come every `interval` [s] are missing. */
export function patience(interval) {
  return Math.max(PATIENCE, 2.5 * interval);
}
