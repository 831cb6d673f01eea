// Buttons, sliders, keys and gamepad.

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
  $("driving").hidden = !sliders.some((each) => each.keys.length);
  $("gamepad").hidden = !sliders.some((each) => each.name === "depth");
  if (!$("driving").hidden) {
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
    ...sliders.flatMap((each) => each.keys.map((key, end) =>
      [[key], `${each.ends[end]}, by ${each.step} ${each.unit}`]).reverse()),
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
  const key = (code, end) => code ? [Object.assign(document.createElement("kbd"),
    { textContent: letter(code), title: each.ends[end] })] : [];
  const name = Object.assign(document.createElement("span"),
    { className: "name", textContent: each.label });
  row.append(name, ...key(each.keys[0], 0), input, ...key(each.keys[1], 1),
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
