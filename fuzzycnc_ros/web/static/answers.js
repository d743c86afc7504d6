// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// What the server says when it does, or does not do, what it was asked for.

/** Return what an answer says, with its status, whatever its form. */
export async function told(answer) {
  const {status, ok} = answer;
  const text = await answer.text();
  let document = {};
  try {
    document = JSON.parse(text) ?? {};
  } catch {
    // No JSON: its text is what it says.
  }
  return {...document, status, done: ok && document.done === true,
    says: document.says ?? `HTTP ${status}: ${text.slice(0, 200)}`};
}

/** Return why something was not answered. */
export async function refusal(answer) {
  return (await told(answer)).says;
}
