// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// What the server says when it does not do what it was asked for.

/** Return what an answer says, whatever its form. */
export async function refusal(answer) {
  const text = await answer.text();
  try {
    return JSON.parse(text).says ?? text;
  } catch {
    return text || `HTTP ${answer.status}`;
  }
}
