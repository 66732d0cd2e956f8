// Exposures that one waits for: asked about first, counted down, broken off.

import { byId, command, connection, setText, show } from "./shell.js";

const LONG_US = 2e6; // as the console has it, which refuses longer ones that nobody asked for
const ASKED = "ask-exposure";

let waiting = null; // the exposure that is asked about
let isFree = false;

const inSeconds = (us) => `${Number((us / 1e6).toPrecision(3))} s`;
const inWords = (us) => (us < 1e6 ? `${Number((us / 1e3).toPrecision(3))} ms` : inSeconds(us));

function ask(exposureUs, nowUs) {
  waiting = exposureUs;
  show(ASKED, exposureUs !== null);
  if (exposureUs === null) return;
  setText("ask-exposure-text", `Each picture will take ${inSeconds(exposureUs)}, and the picture does not change meanwhile.`);
  setText("expose-long", `Expose ${inSeconds(exposureUs)}`);
  setText("keep-exposure", `Keep ${inWords(nowUs)}`);
}

let nowUs = 0, longestUs = 0; // what the camera cannot do is not asked about

export function setExposure(exposureUs) {
  if (exposureUs > LONG_US && exposureUs <= longestUs) return ask(exposureUs, nowUs);
  ask(null);
  command("exposure", { exposure_us: exposureUs });
}

byId("expose-long").onclick = () => {
  command("exposure", { exposure_us: waiting, is_long_wanted: true });
  ask(null);
};
byId("keep-exposure").onclick = () => ask(null);
byId("break-off").onclick = () => command("break-off");
window.addEventListener("keydown", (event) => { if (event.key === "Escape") ask(null); }, true);
connection.addEventListener("lost", () => { ask(null); show("exposing", false); });

connection.addEventListener("state", ({ detail: { camera, run, job, control, exposure_limits_us: limits } }) => {
  longestUs = limits[1];
  nowUs = camera.exposure_us ?? 0;
  isFree = control.is_mine && camera.state === "ready" && !["running", "paused"].includes(run.state);
  if (!isFree && waiting !== null) ask(null);
  const { exposing } = camera;
  show("exposing", Boolean(exposing));
  if (!exposing) return;
  const left = `${exposing.left} s left of ${exposing.seconds} s`;
  setText("exposing-text", exposing.is_dropped ? `The camera cannot abort its exposure: ${left}, then that picture is dropped.` : `Exposing: ${left}.${job ? ` STOP ends it with ${job.name}.` : ""}`);
  byId("exposing-progress").max = exposing.seconds;
  byId("exposing-progress").value = exposing.seconds - exposing.left;
  show("break-off", !exposing.is_dropped && !job);
  byId("break-off").disabled = !isFree;
});
