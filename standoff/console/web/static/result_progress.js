// The result that is computed, or how the last one ended: on every page that can ask for one.

import { byId, command, setText, show } from "./shell.js";

const LEVELS = { running: "warn", done: "ok", failed: "fail", stopped: "warn" };

export class ResultProgress {
  // Of results that `isOurs` says are this page's.
  constructor(isOurs) {
    this.isOurs = isOurs;
    this.wasRunning = false;
    this.numberSeen = null; // of the last result: each one has the next number
    byId("cancel-result").onclick = () => command("cancel-result");
  }

  // Show a state; true once one of this page's results has ended.
  show({ job, control, result }) {
    const isRunning = result.state === "running";
    byId("cancel-result").disabled = !control.is_mine || !isRunning || Boolean(job?.is_stopping);
    show("result-progress", isRunning);
    setText("result-title", `${result.title.charAt(0).toUpperCase()}${result.title.slice(1)}`);
    setText("result-text", [job?.is_stopping ? "stopping" : result.text || "starting", result.total ? `${result.done} of ${result.total}` : "", `${result.seconds} s`].filter(Boolean).join(" · "));
    const bar = byId("result-bar");
    if (result.total) { bar.max = result.total; bar.value = result.done; } else bar.removeAttribute("value");
    show("result-message", !isRunning && this.isOurs(result) && Boolean(result.message));
    byId("result-message").className = `alert ${result.is_alarming ? "warn" : LEVELS[result.state] || ""}`;
    setText("result-words", result.message);
    show("result-page", Boolean(result.page));
    byId("result-page").href = result.page;
    // A result that is done before the next state comes is shown as well.
    const isEnded = !isRunning && (this.wasRunning || (this.numberSeen !== null && result.number !== this.numberSeen));
    this.numberSeen = result.number;
    this.wasRunning = isRunning;
    return isEnded && this.isOurs(result);
  }
}
