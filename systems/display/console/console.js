window.sonoservo = (() => {
  const $ = (id) => document.getElementById(id);
  const BUTTONS = {
    pause: ["pause", "Space"], step: ["step", "Period"], restart: ["restart", "KeyR"],
    save: ["save", "KeyV"], finish: ["finish", "KeyF"], stop: ["stop", ""],
  };
  const HELP = {
    pause: "pause or go on", step: "go on by one volume, then pause",
    restart: "start again; what you did so far is saved",
    save: "save what you did so far as a scenario", finish: "end, and write the results",
    stop: "end now, as Ctrl-C does",
  };
  const SPEEDS = [[0.25, "¼ ×"], [0.5, "½ ×"], [1, "1 ×"], [2, "2 ×"], [0, "max"]];
  const letter = (code) => ({ Space: "space", Period: "." })[code] ?? code.replace("Key", "");
  const plain = (value) => value instanceof Map
    ? Object.fromEntries([...value].map(([name, each]) => [name, plain(each)]))
    : Array.isArray(value) ? value.map(plain) : value;

  let link, grey, figures, state = {}, described = {}, orders = 0, armed = false, held = null;

  let connected = true;
  const send = (name, value) => { if (connected) link[name].tags = [value]; };
  const order = (fields) => send("order", { ...fields, order: ++orders });
  // What was asked for here holds until the console has heard of it.
  const asked = new Map();
  const text = (id, value) => { if ($(id).textContent !== value) $(id).textContent = value; };
  const number = (value, digits) =>
    value == null ? "–" : value.toFixed(digits).replace("-", "−");

  // Controls

  function button(label, key, act, title) {
    const made = document.createElement("button");
    made.append(label);
    if (key) made.append(Object.assign(document.createElement("kbd"), { textContent: letter(key) }));
    made.title = title ?? "";
    made.onclick = () => { act(made); made.blur(); };
    return made;
  }

  function press(name) {
    const made = $("buttons").querySelector(`[data-name=${name}]`);
    if (name === "stop" && !made.classList.contains("sure")) {
      made.classList.add("sure");
      made.firstChild.textContent = "really stop?";
      setTimeout(() => { made.classList.remove("sure"); made.firstChild.textContent = "stop"; }, 3000);
      return;
    }
    order({ press: name });
  }

  function arm(on) {
    armed = on;
    const made = $("arm");
    if (!made) return;
    made.setAttribute("aria-pressed", on);
    made.firstChild.textContent = on ? "keys on" : "keys off";
  }

  function build() {
    const names = described.buttons ?? [], sliders = described.sliders ?? [];
    const parts = names.map((name) => {
      const [label, key] = BUTTONS[name];
      const made = button(label, key, () => press(name), HELP[name]);
      made.dataset.name = name;
      if (name === "stop") made.classList.add("danger");
      return made;
    });
    if (names.includes("pause") && described.speeds) {
      const speed = document.createElement("select");
      speed.id = "speed";
      speed.title = "speed, as a multiple of real time";
      for (const [value, label] of SPEEDS) speed.add(new Option(label, value));
      speed.onchange = () => { order({ speed: Number(speed.value) }); speed.blur(); };
      parts.splice(names.includes("step") ? 2 : 1, 0, speed);
    }
    if (sliders.some((each) => each.keys.length)) {
      const made = button("keys off", "", () => arm(!armed),
        "Let keys move things; a key pressed by mistake moves nothing while this is off");
      made.id = "arm";
      parts.push(made);
    }
    $("buttons").replaceChildren(...parts);
    $("controls").hidden = !parts.length && !sliders.length;
    $("sliders").replaceChildren(...sliders.map(slider));
    arm(false);
    $("keys").replaceChildren(...[
      ...names.filter((name) => BUTTONS[name][1]).map((name) => [[BUTTONS[name][1]], HELP[name]]),
      ...sliders.filter((each) => each.keys.length)
        .map((each) => [each.keys, `${each.label}, by ${each.step} ${each.unit}`]),
      [["KeyN"], "show or hide the needle beside its echo"], [["?"], "this help"],
    ].map(([keys, what]) => {
      const row = document.createElement("tr");
      row.insertCell().append(...keys.flatMap((key) =>
        [Object.assign(document.createElement("kbd"), { textContent: letter(key) }), " "]));
      row.insertCell().textContent = what;
      return row;
    }));
  }

  function slider(each) {
    const row = document.createElement("label"), input = document.createElement("input");
    Object.assign(input, { type: "range", min: each.least, max: each.most, step: "any" });
    input.dataset.name = each.name;
    input.oninput = () => {
      held = each.name;
      move(each, Math.round(input.value / each.step) * each.step);
    };
    input.onchange = () => { held = null; input.blur(); };
    const key = (code) => code
      ? [Object.assign(document.createElement("kbd"), { textContent: letter(code) })] : [];
    const name = Object.assign(document.createElement("span"),
      { className: "name", textContent: each.label });
    row.append(name, ...key(each.keys[0]), input, ...key(each.keys[1]),
      document.createElement("output"));
    return row;
  }

  function move(each, value) {
    value = Math.min(Math.max(Number(value.toFixed(6)), each.least), each.most);
    state.values[each.name] = value;
    order({ set: each.name, value });
    asked.set(each.name, { value, order: orders });
    showValues();
  }

  function showValues() {
    for (const each of described.sliders ?? []) {
      const input = $("sliders").querySelector(`[data-name=${each.name}]`);
      const value = state.values?.[each.name];
      if (!input || value == null) continue;
      if (held !== each.name) input.value = value;
      input.parentElement.querySelector("output").textContent =
        `${number(value, each.step < 1 ? 1 : 0)} ${each.unit}`;
    }
    if ($("speed")) $("speed").value = state.speed;
  }

  function key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.isComposing) return;
    const target = event.target?.tagName;
    if ($("help").open) return;
    if (event.key === "?") return $("help").showModal();
    if (event.code === "KeyN" && !event.repeat) return $("overlay").click();
    if (event.code === "Space") {
      if (target === "BUTTON" || target === "SELECT") return;
      event.preventDefault();
      if (!event.repeat && described.buttons?.includes("pause")) press("pause");
      return;
    }
    if (!armed || target === "SELECT") return;
    const name = (described.buttons ?? []).find((each) => BUTTONS[each][1] === event.code);
    if (name && !event.repeat) return press(name);
    for (const each of described.sliders ?? []) {
      const end = each.keys.indexOf(event.code);
      if (end >= 0) move(each, state.values[each.name] + (end ? each.step : -each.step));
    }
  }

  let axes = [];
  function readGamepad() {
    const pad = [...navigator.getGamepads()].find((each) => each);
    const read = pad ? [...pad.axes].map((axis) => Number(axis.toFixed(2))) : [];
    if (read.join() !== axes.join()) order({ axes: axes = read });
  }

  // Strips

  function scale() {
    if (state.time == null) return;
    const end = Math.max(state.time, 10);
    figures.mode.x_range.setv({ start: Math.max(0, end - 60), end });
    for (const plot of Object.values(figures)) {
      const [least] = plot.tags;
      if (typeof least !== "number") continue;
      const values = plot.renderers.flatMap(({ data_source, glyph }) =>
        [...data_source.get(glyph.y.field)].filter(Number.isFinite));
      if (!values.length) continue;
      let [low, high] = values.reduce(([a, b], y) => [Math.min(a, y), Math.max(b, y)], [1e9, -1e9]);
      const margin = Math.max(0.08 * (high - low), (least - high + low) / 2);
      [low, high] = [low - margin, high + margin];
      const { start, end: top } = plot.y_range, slack = 0.15 * (high - low);
      if (low < start || high > top || low > start + slack || high < top - slack)
        plot.y_range.setv({ start: low, end: high });
    }
  }

  // World

  let far = null;
  function closeUp(frame) {
    const viewer = frame.contentWindow.viewer, probe = viewer?.scene_tree.find(["sector"]).object;
    if (!probe) return;
    const camera = ["Cameras", "default", "rotated", "<object>"];
    const look = (position, target) => {
      viewer.set_property(camera, "position", position);
      viewer.set_camera_target(target);
    };
    if (far) {
      look(...far);
      far = null;
    } else {
      far = [viewer.camera.position.toArray(), viewer.controls.target.toArray()];
      // The camera's frame has Y up; the sector is at the face of the probe.
      const { x, y, z } = probe.position, target = [x, z - 0.04, -y];
      look([target[0] + 0.16, target[1] + 0.1, target[2] + 0.24], target);
    }
    $("close-up").setAttribute("aria-pressed", Boolean(far));
  }

  // Slices

  function fit() {
    (state.windows ?? []).forEach((window, n) => {
      if (!window) return;
      const [left, right, top, bottom] = window;
      const plot = figures[`slice_${n}`];
      const [width, height] = [plot.inner_width, plot.inner_height];
      if (!(width > 0 && height > 0)) return;
      const scale = Math.max((right - left) / width, (bottom - top) / height);
      const [x, y] = [(left + right) / 2, (top + bottom) / 2];
      const [w, h] = [(scale * width) / 2, (scale * height) / 2];
      plot.x_range.setv({ start: x - w, end: x + w });
      plot.y_range.setv({ start: y + h, end: y - h });
    });
  }

  function contrast() {
    const [gain, range] = [Number($("view-gain").value), Number($("view-window").value)];
    const level = state.decibels_per_level ?? 60 / 255;
    const high = 255 - gain / level;
    grey.setv({ low: high - range / level, high });
    $("view-gain").nextElementSibling.textContent = `${gain} dB`;
    $("view-window").nextElementSibling.textContent = `${range} dB`;
  }

  function scroll(n, event) {
    event.preventDefault();
    const offsets = [...(state.offsets ?? [0, 0])];
    offsets[n] = Number((offsets[n] + Math.sign(event.deltaY)).toFixed(1));
    shift(offsets);
  }

  function shift(offsets) {
    state.offsets = offsets;
    order({ offsets });
    asked.set("offsets", { value: offsets, order: orders });
    showOffsets();
  }

  function showOffsets() {
    document.querySelectorAll(".offset").forEach((each, n) => {
      const mm = state.offsets?.[n] ?? 0;
      each.textContent = mm ? `${mm > 0 ? "+" : "−"}${Math.abs(mm)} mm beside it` : "";
    });
  }

  function cine() {
    const [first, last] = state.cine ?? [0, 0], share = Number($("cine").value) / 1000;
    order({ cine: share >= 1 ? null : first + share * (last - first) });
  }

  function overlay() {
    const on = $("overlay").getAttribute("aria-pressed") !== "true";
    $("overlay").setAttribute("aria-pressed", on);
    for (const n of [0, 1])
      for (const each of figures[`slice_${n}`].renderers)
        if (/rails|ring/.test(each.name ?? "")) each.visible = on;
  }

  // Everything that a new state changes

  function show() {
    state = plain(link.state.tags[0]);
    for (const [name, each] of asked) {
      if (state.heard >= each.order) asked.delete(name);
      else (name === "offsets" ? state : state.values)[name] = each.value;
    }
    $("state").dataset.kind = state.ended ? "showing" : state.kind;
    for (const each of $("mark").children)
      each.style.display = each.classList.contains($("state").dataset.kind) ? "inline" : "none";
    text("word", state.ended ? "ended" : state.paused ? `paused · ${state.word}` : state.word ?? "");
    text("detail", state.ended || [state.detail, state.advice].filter(Boolean).join(": "));
    $("detail").title = $("detail").textContent;
    text("held", [state.held && `held: ${state.held}`, state.note].filter(Boolean).join(" · "));
    $("held").hidden = !$("held").textContent;
    text("title", state.title ?? "");
    text("time", state.time == null ? "" : `${state.time.toFixed(1)} s`);
    text("pace", state.pace ?? "");
    $("report").hidden = !state.report;
    if (state.report) $("report").href = state.report + location.search;
    for (const name of ["x", "z", "theta", "depth"]) text(name, number(state[name], 1));
    for (const name of ["force", "error"]) text(name, number(state[name], 2));
    if (described.buttons?.includes("pause"))
      $("buttons").querySelector("[data-name=pause]").firstChild.textContent =
        state.paused ? "go on" : "pause";
    showValues();
    showOffsets();
    document.querySelectorAll(".slice .title").forEach((each, n) => {
      each.textContent = state.titles?.[n] ?? "";
    });
    const [first, last] = state.cine ?? [0, 0];
    if (state.live && document.activeElement !== $("cine")) $("cine").value = 1000;
    $("cine").disabled = !(last > first);
    $("cine").nextElementSibling.textContent = state.live ? "live"
      : state.volume_time == null ? "" : `−${(last - state.volume_time).toFixed(1)} s`;
    $("live").setAttribute("aria-pressed", Boolean(state.live));
    const frame = $("world").firstElementChild;
    if (state.world && !frame.getAttribute("src")) {
      frame.src = `../${state.world}/${location.search}`;
      frame.hidden = false;
      $("legend").hidden = $("see").hidden = state.world !== "world";
    }
    const without = state.without ?? [];
    for (const each of ["slices", "strips", "readings"])
      document.body.classList.toggle(`no-${each}`, without.includes(each));
    for (const each of ["force", "error"])
      $(`strip-${each}`).hidden = $(each).parentElement.hidden = without.includes(each);
    scale();
    fit();
    contrast();
    const shown = state.number;
    requestAnimationFrame(() => { send("drawn", shown); });
  }

  function describe() {
    described = plain(link.described.tags[0]);
    build();
  }

  function gone() {
    connected = false;
    $("gone").hidden = false;
    $("state").style.opacity = 0.5;
    const again = setInterval(() => fetch(location.href).then((answer) => {
      if (answer.ok) { clearInterval(again); location.reload(); }
    }, () => {}), 3000);
  }

  function start(...given) {
    [link, grey, figures] = given;
    [link, figures] = [plain(link), plain(figures)];
    link.state.properties.tags.change.connect(show);
    link.described.properties.tags.change.connect(() => { describe(); show(); });
    link.state.document.on_event("connection_lost", gone);
    for (const n of [0, 1]) {
      const plot = figures[`slice_${n}`];
      plot.properties.inner_width.change.connect(fit);
      plot.properties.inner_height.change.connect(fit);
      document.querySelector(`[data-slice="${n}"]`)
        .addEventListener("wheel", (event) => scroll(n, event), { passive: false });
    }
    for (const id of ["view-gain", "view-window"]) $(id).oninput = contrast;
    $("cine").oninput = cine;
    $("cine").onchange = () => $("cine").blur();
    $("live").onclick = () => { $("cine").value = 1000; cine(); $("live").blur(); };
    $("centre").onclick = () => { shift([0, 0]); $("centre").blur(); };
    $("overlay").onclick = () => { overlay(); $("overlay").blur(); };
    $("help-button").onclick = () => { $("help").showModal(); };
    window.addEventListener("keydown", key);
    window.addEventListener("blur", () => setTimeout(() => {
      if (!document.hasFocus()) arm(false);
    }));
    const frame = $("world").firstElementChild;
    frame.onload = () => {
      frame.contentWindow.addEventListener("keydown", key);
      if (frame.contentWindow.viewer) frame.contentWindow.viewer.gui.domElement.hidden = true;
    };
    $("layers").onclick = () => {
      const gui = frame.contentWindow.viewer?.gui;
      if (gui) { gui.domElement.hidden = !gui.domElement.hidden; gui.open(); }
      $("layers").blur();
    };
    $("close-up").onclick = () => { closeUp(frame); $("close-up").blur(); };
    setInterval(readGamepad, 100);
    describe();
    show();
    document.body.dataset.ready = "";
  }
  return { start };
})();
