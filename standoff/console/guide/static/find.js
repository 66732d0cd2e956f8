// Several references: the one that the camera sees is opened.

import { Camera } from "./camera.js";

const $ = (id) => document.getElementById(id);

function show({ found, fault, lost }) {
  const text = lost ? "The link to the computer is lost; this page keeps trying." : fault ?? "";
  $("fault").textContent = text;
  $("fault").hidden = !text;
  if (found?.of) location.assign(`?of=${encodeURIComponent(found.of)}`);
}

$("find").addEventListener("click", async () => {
  if (!navigator.mediaDevices?.getUserMedia) {
    show({ fault: "This browser gives pages no camera. Choose the reference below." });
    return;
  }
  const camera = new Camera($("video"), show, "find");
  [$("video").hidden, $("finding").hidden, $("find").hidden] = [false, false, true];
  try {
    await camera.open();
  } catch (error) {
    camera.close();
    [$("video").hidden, $("finding").hidden, $("find").hidden] = [true, true, false];
    show({ fault: `The camera cannot be used: ${error.message}. Choose the reference below.` });
  }
});
$("find").disabled = false;
