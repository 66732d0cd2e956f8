"use strict";
// Links the views of a frame: one zoom and place for all, and a large view that blinks.
// Without this script the page shows the same views side by side, as on paper.
for (const section of document.querySelectorAll("section.views")) {
  const figures = section.querySelector(".figures");
  const views = [...figures.querySelectorAll("svg[data-view]")];
  if (!views.length) continue;
  const [left, top, width, height] = views[0].getAttribute("viewBox").split(" ").map(Number);
  const frame = { x: left, y: top, w: width };
  const place = { ...frame };
  const names = { before: "before", after: "after", difference: "difference" };
  const SVG = "http://www.w3.org/2000/svg";
  const SMALLEST_PX = 12, WHEEL = 1.0015, STEP = 1.4, BLINK_MS = 600;

  // The large view uses the pictures of the small ones: the page holds each of them once.
  const large = document.createElement("div");
  large.className = "view-large";
  const stage = document.createElementNS(SVG, "svg");
  stage.setAttribute("role", "img");
  const tag = document.createElement("div");
  tag.className = "name";
  const layers = {};
  const serial = [...document.querySelectorAll("section.views")].indexOf(section);
  for (const view of views) {
    const name = view.dataset.view;
    const picture = view.querySelector(".picture");
    picture.id = `view-${serial}-${name}`;
    layers[name] = document.createElementNS(SVG, "use");
    layers[name].setAttribute("href", `#${picture.id}`);
    stage.append(layers[name]);
  }
  const masks = document.createElementNS(SVG, "use");
  views[0].querySelector(".masks").id = `view-${serial}-masks`;
  masks.setAttribute("href", `#view-${serial}-masks`);
  masks.setAttribute("class", "masks");
  stage.append(masks, views[0].querySelector(".marks").cloneNode(true));
  large.append(stage, tag);
  const all = [...views, stage];

  const bar = document.createElement("div");
  bar.className = "view-bar";
  const where = document.createElement("output");
  const button = (text, act, title) => {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = text;
    made.title = title;
    made.addEventListener("click", act);
    bar.append(made);
    return made;
  };
  const gap = () => bar.append(Object.assign(document.createElement("span"), { className: "gap" }));

  let shown = "after", timer = 0, chosen = 0;
  const buttons = {};
  const show = (name) => {
    shown = name;
    for (const [other, layer] of Object.entries(layers)) {
      layer.style.display = other === name ? "" : "none";
      buttons[other].setAttribute("aria-pressed", String(other === name));
    }
    tag.textContent = names[name];
    stage.setAttribute("aria-label", `large view: ${names[name]}`);
  };
  const pause = () => {
    clearInterval(timer);
    timer = 0;
    blink.setAttribute("aria-pressed", "false");
  };
  const turn = () => show(shown === "after" ? "before" : "after");
  const setBlink = (isOn) => {
    pause();
    if (!isOn) return;
    blink.setAttribute("aria-pressed", "true");
    turn();
    timer = setInterval(turn, Number(pace.value));
  };
  for (const name of Object.keys(layers)) {
    buttons[name] = button(names[name], () => { pause(); show(name); }, `show ${names[name]}`);
  }
  gap();
  const blink = button("blink", () => setBlink(!timer), "show before and after in turn (b)");
  const pace = document.createElement("input");
  Object.assign(pace, { type: "range", min: 150, max: 1500, step: 50, value: BLINK_MS });
  pace.title = "time of each photograph";
  pace.setAttribute("aria-label", "milliseconds of each photograph");
  pace.addEventListener("input", () => timer && setBlink(true));
  bar.append(pace);
  gap();
  const draw = () => {
    const share = place.w / frame.w;
    const box = `${place.x} ${place.y} ${place.w} ${share * height}`;
    // Rings and numbers keep their size on the screen, but never hide what they point at.
    const scale = Math.max(share, 0.08);
    for (const view of all) {
      view.setAttribute("viewBox", box);
      view.classList.toggle("near", place.w * 2 < view.clientWidth);
      for (const mark of view.querySelectorAll("[data-change]")) {
        const { y, radius } = mark.dataset;
        if (mark.dataset.size === undefined) {
          const text = mark.querySelector("text");
          mark.dataset.size = text.getAttribute("font-size");
          mark.dataset.rise = text.getAttribute("y") - y;
          for (const one of mark.querySelectorAll("[stroke-width]"))
            one.dataset.stroke = one.getAttribute("stroke-width");
        }
        const size = mark.dataset.size * scale;
        for (const text of mark.querySelectorAll("text")) {
          text.setAttribute("font-size", size);
          const rise = Number(radius) + 0.25 * size;
          text.setAttribute("y", Number(y) + (mark.dataset.rise < 0 ? -rise : rise + 0.7 * size));
        }
        for (const one of mark.querySelectorAll("[data-stroke]"))
          one.setAttribute("stroke-width", one.dataset.stroke * scale);
      }
    }
  };
  const clamp = () => {
    place.w = Math.min(Math.max(place.w, Math.min(SMALLEST_PX, frame.w)), frame.w);
    const h = place.w / width * height;
    place.x = Math.min(Math.max(place.x, frame.x), frame.x + width - place.w);
    place.y = Math.min(Math.max(place.y, frame.y), frame.y + height - h);
  };
  const zoom = (factor, x, y) => {
    const before = place.w;
    place.w *= factor;
    place.w = Math.min(Math.max(place.w, Math.min(SMALLEST_PX, frame.w)), frame.w);
    const ratio = place.w / before;
    place.x = x + (place.x - x) * ratio;
    place.y = y + (place.y - y) * ratio;
    clamp();
    draw();
  };
  const middle = () => [place.x + place.w / 2, place.y + place.w / width * height / 2];
  const whole = () => { Object.assign(place, frame); draw(); };
  const at = (view, event) => {
    const point = new DOMPoint(event.clientX, event.clientY);
    return point.matrixTransform(view.getScreenCTM().inverse());
  };
  button("+", () => zoom(1 / STEP, ...middle()), "nearer (+)");
  button("−", () => zoom(STEP, ...middle()), "further away (-)");
  button("whole", whole, "the whole frame (0)");
  gap();
  const marksButton = button("rings", () => toggle("marks"), "numbered changes (r)");
  const masksButton = button("masks", () => toggle("masks"), "pixels that were not compared (m)");
  marksButton.setAttribute("aria-pressed", "true");
  masksButton.setAttribute("aria-pressed", "true");
  const toggle = (kind) => {
    const isOff = section.querySelector(".linked").classList.toggle(`no-${kind}`);
    large.classList.toggle(`no-${kind}`, isOff);
    (kind === "marks" ? marksButton : masksButton).setAttribute("aria-pressed", String(!isOff));
  };
  bar.append(where);

  for (const view of all) {
    view.addEventListener("wheel", (event) => {
      event.preventDefault();
      const point = at(view, event);
      zoom(WHEEL ** event.deltaY, point.x, point.y);
    }, { passive: false });
    view.addEventListener("dblclick", whole);
    let last = null;
    view.addEventListener("pointerdown", (event) => {
      last = at(view, event);
      view.setPointerCapture(event.pointerId);
      view.classList.add("dragged");
    });
    view.addEventListener("pointermove", (event) => {
      const point = at(view, event);
      where.textContent = `follow-up x ${point.x.toFixed(1)}, y ${point.y.toFixed(1)} px`;
      if (!last) return;
      place.x -= point.x - last.x;
      place.y -= point.y - last.y;
      clamp();
      draw();
    });
    const drop = () => { last = null; view.classList.remove("dragged"); };
    view.addEventListener("pointerup", drop);
    view.addEventListener("pointercancel", drop);
    view.addEventListener("pointerleave", () => { where.textContent = ""; });
  }

  const table = section.querySelector("table.changes");
  const rows = table ? [...table.tBodies[0].rows] : [];
  const choose = (number) => {
    chosen = number;
    rows.forEach((row, k) => row.classList.toggle("chosen", k + 1 === number));
    for (const view of all)
      for (const mark of view.querySelectorAll("[data-change]"))
        mark.classList.toggle("chosen", Number(mark.dataset.change) === number);
    const mark = stage.querySelector(`[data-change="${number}"]`);
    if (!mark) return;
    const reach = Math.max(10 * mark.dataset.radius, width / 8);
    place.w = Math.min(reach, frame.w);
    place.x = mark.dataset.x - place.w / 2;
    place.y = mark.dataset.y - place.w / width * height / 2;
    clamp();
    draw();
  };
  if (table) table.classList.add("linked-table");
  rows.forEach((row, k) => {
    row.tabIndex = 0;
    row.addEventListener("click", () => {
      choose(k + 1);
      large.scrollIntoView({ block: "nearest", behavior: "smooth" });
    });
    row.addEventListener("keydown", (event) => event.key === "Enter" && row.click());
  });

  const step = (by) => rows.length && choose((chosen - 1 + by + rows.length) % rows.length + 1);
  const keys = {
    b: () => setBlink(!timer),
    " ": () => { pause(); turn(); },
    d: () => { pause(); show("difference"); },
    "+": () => zoom(1 / STEP, ...middle()),
    "=": () => zoom(1 / STEP, ...middle()),
    "-": () => zoom(STEP, ...middle()),
    0: whole,
    n: () => step(1),
    p: () => step(chosen ? -1 : 0),
    r: () => toggle("marks"),
    m: () => toggle("masks"),
  };
  if (serial === 0) document.addEventListener("keydown", (event) => {
    const isTyping = event.target.closest("input, summary, a");
    const isPressing = event.key === " " && event.target.closest("button");
    if (event.ctrlKey || event.altKey || event.metaKey || isTyping || isPressing) return;
    const act = keys[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });

  const help = document.createElement("p");
  help.className = "view-keys";
  help.innerHTML = "Drag to move, wheel to zoom, double-click for the whole frame. Keys: "
    + "<kbd>b</kbd> blink, <kbd>space</kbd> before or after, <kbd>d</kbd> difference, "
    + "<kbd>n</kbd> <kbd>p</kbd> next and previous change, <kbd>+</kbd> <kbd>-</kbd> "
    + "<kbd>0</kbd> zoom, <kbd>r</kbd> rings, <kbd>m</kbd> masks.";
  figures.classList.add("linked");
  figures.before(bar, large);
  figures.after(help);
  show(shown);
  draw();
}
