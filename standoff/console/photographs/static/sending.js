// A photograph in parts, by its hash: it goes on where the computer says, however often the link is lost.

const PART_BYTES = 256 * 1024;
const ANSWER_MS = 30000;

export const RETRY_MS = [500, 1000, 2000, 4000];
export const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

export class Refused extends Error {}
export class NotHere extends Error {}
export class NotYet extends Error {}

async function asked(path, options) {
  // Without a limit a request whose packets vanish would wait for ever.
  const answer = await fetch(path, { ...options, signal: AbortSignal.timeout(ANSWER_MS) });
  const document = await answer.json().catch(() => ({}));
  if (answer.ok) return document;
  if (answer.status === 401) throw new NotYet("this phone is not paired any more: scan the code again");
  if (answer.status === 404) throw new NotHere(document.text);
  if (answer.status === 413 || answer.status === 422) throw new Refused(document.text);
  throw new NotYet(document.text || `the computer answers ${answer.status}`);
}

// SHA-256 of an ArrayBuffer, in hexadecimal digits.
export async function digestOf(bytes) {
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes));
  return Array.from(digest, (value) => value.toString(16).padStart(2, "0")).join("");
}

// Send an ArrayBuffer to `path`, with what is told of it in every address as `facts`.
export async function send(path, { sha256, bytes, facts }, progress) {
  const told = `bytes=${bytes.byteLength}&${new URLSearchParams(facts)}`;
  let { received, is_stored: isStored } = await asked(`${path}?sha256=${sha256}&${told}`, { method: "POST" });
  while (!isStored) {
    progress(received / bytes.byteLength);
    const body = bytes.slice(received, received + PART_BYTES);
    ({ received, is_stored: isStored } = await asked(`${path}/${sha256}?offset=${received}&${told}`, { method: "PUT", body }));
  }
}
