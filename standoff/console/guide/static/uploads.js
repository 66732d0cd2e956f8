// Photographs on their way: each is kept in the phone until the computer has it whole and verified.

import { NotHere, NotYet, RETRY_MS, Refused, digestOf, pause, send } from "../sending/sending.js";

const opened = new Promise((resolve, reject) => {
  const asked = indexedDB.open("standoff-guide", 1);
  asked.onupgradeneeded = () => asked.result.createObjectStore("waiting", { keyPath: "sha256" });
  asked.onsuccess = () => resolve(asked.result);
  asked.onerror = () => reject(asked.error);
});

async function stored(mode, work) {
  const base = await opened;
  return new Promise((resolve, reject) => {
    const change = base.transaction("waiting", mode);
    const asked = work(change.objectStore("waiting"));
    change.oncomplete = () => resolve(asked.result);
    change.onerror = change.onabort = () => reject(change.error);
  });
}

let running = null;
let wanted = false;

// Send all that waits, one after another; a lost link is tried again until it is back.
export function sendWaiting(tell) {
  wanted = true;
  running ??= (async () => {
    try {
      while (wanted) {
        wanted = false; // what is kept meanwhile asks again
        await sendAll(tell);
      }
    } finally {
      running = null;
    }
  })();
  return running;
}

async function sendAll(tell) {
  const left = new Set(); // photographs of a reference that is not served now
  for (;;) {
    const all = await stored("readonly", (store) => store.getAll());
    const waiting = all.find(({ sha256, refused }) => !refused && !left.has(sha256));
    if (!waiting) break;
    for (let attempt = 0; ; attempt += 1) {
      try {
        const { sha256, bytes, location, of } = waiting;
        const told = (share) => tell({ share, words: "Sending the photograph." });
        await send("stills", { sha256, bytes, facts: { location, of } }, told);
        await forget(waiting.sha256);
        break;
      } catch (error) {
        if (error instanceof NotHere) {
          left.add(waiting.sha256);
          break;
        }
        if (error instanceof Refused) {
          // It may exist nowhere else: only whoever took it throws it away.
          await stored("readwrite", (store) => store.put({ ...waiting, refused: error.message }));
          tell({ refused: true });
          break;
        }
        const what = error instanceof NotYet ? "It cannot be sent yet" : "The link is lost";
        tell({ words: `${what} (${error.message}). The photograph is kept here, and sent as soon as that is possible.` });
        await pause(RETRY_MS[Math.min(attempt, RETRY_MS.length - 1)]);
      }
    }
  }
  tell({ done: true });
}

// Photographs that the computer refused, with its reason as `refused`.
export async function refusedOnes() {
  return (await stored("readonly", (store) => store.getAll())).filter(({ refused }) => refused);
}

export function forget(sha256) {
  return stored("readwrite", (store) => store.delete(sha256));
}

export function sendAgain({ refused, ...waiting }) {
  return stored("readwrite", (store) => store.put(waiting));
}

// Keep a photograph (a Blob) in the phone, to be sent: of which reference, with its location or not.
export async function keep(blob, facts) {
  const bytes = await blob.arrayBuffer();
  const sha256 = await digestOf(bytes);
  await stored("readwrite", (store) => store.put({ sha256, bytes, ...facts }));
}
