// What the parts of the page share, and everything that a new state changes.

const $ = (id) => document.getElementById(id);
const BUTTONS = {
  pause: ["pause", "Space"], step: ["step", "Period"], restart: ["restart", "KeyR"],
  save: ["save", "KeyV"], finish: ["finish", "KeyF"], stop: ["stop", ""],
};
const HELP = {
  pause: "pause or go on", step: "go on by one volume, then pause",
  restart: "start again; what you did so far is saved",
  save: "save what you did so far as a scenario", finish: "end, and write the results",
  stop: "end now, as Ctrl-C does; asks once more",
};
const SPEEDS = [[0.25, "¼ ×"], [0.5, "½ ×"], [1, "1 ×"], [2, "2 ×"], [0, "max"]];
const LETTERS = { Space: "space", Period: ".", ArrowLeft: "←", ArrowRight: "→" };
const KINDS = {
  needle: "may be needles", resting: "at rest", riding: "with the probe", appeared: "new",
  nothing: "speckle",
};
const letter = (code) => LETTERS[code] ?? code.replace("Key", "");
const plain = (value) => (value instanceof Map ? Object.fromEntries(value) : value);

let link, grey, figures, state = {}, described = {}, orders = 0, armed = false, held = null;

let connected = true;
const send = (name, value) => { if (connected) link[name].tags = [value]; };
const order = (fields) => send("order", { ...fields, order: ++orders });
// What was asked for here holds until the console has heard of it.
const asked = new Map();
const text = (id, value) => { if ($(id).textContent !== value) $(id).textContent = value; };
const number = (value, digits) =>
  value == null ? "–" : value.toFixed(digits).replace("-", "−");

// Everything that a new state changes

function receive() {
  const [words, ...images] = link.state.tags;
  const { frame, strips, ...told } = JSON.parse(words);
  state = told;
  if (strips) showStrips(strips);
  if (frame) showPictures(frame, images);
  show();
}

function show() {
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
  showReadings();
  if (described.buttons?.includes("pause"))
    $("buttons").querySelector("[data-name=pause]").firstChild.textContent =
      state.paused ? "go on" : "pause";
  showValues();
  showOffsets();
  const [first, last] = state.cine ?? [0, 0];
  if (state.live && document.activeElement !== $("cine")) $("cine").value = 1000;
  $("cine").disabled = !(last > first);
  $("cine").nextElementSibling.textContent = state.live ? "live"
    : state.volume_time == null ? "" : `−${(last - state.volume_time).toFixed(1)} s`;
  $("live").setAttribute("aria-pressed", Boolean(state.live));
  const frame = $("world").firstElementChild;
  if (state.world && !frame.getAttribute("src")) {
    const page = state.world.endsWith(".html") ? state.world : `${state.world}/`;
    frame.src = `../${page}${location.search}`;
    frame.hidden = false;
    $("legend").hidden = $("see").hidden = state.world === "probe";
  }
  if (state.legend && $("legend").dataset.said !== String(state.legend)) {
    $("legend").dataset.said = state.legend;
    $("legend").replaceChildren(...state.legend.map((entry) => {
      const [colour, ...words] = entry.split(" "), each = document.createElement("span");
      each.append(Object.assign(document.createElement("i"), { className: colour }),
        words.join(" "));
      return each;
    }));
    $("close-up").hidden = true;
  }
  const without = state.without ?? [];
  seek(frame);
  for (const each of ["world", "slices", "second", "planes", "cine", "strips", "readings"])
    document.body.classList.toggle(`no-${each}`, without.includes(each));
  for (const each of document.querySelectorAll(".strip"))
    each.hidden = without.includes(each.dataset.name) || (each.matches(".chart") && !charted);
  const bottom = [...document.querySelectorAll(".strip:not(.chart, [hidden])")].at(-1);
  for (const each of document.querySelectorAll(".strip:not(.chart)"))
    figures[each.dataset.name].below[0].visible = each === bottom;
  scale();
  fit();
  contrast();
  const shown = state.number;
  // What ends a run waits for the page, so that the world, which is sent by itself, ends as well.
  const tell = () => {
    if (state.number !== shown) return;
    if (state.ended && state.world === "world" && !wound) setTimeout(tell, 100);
    else send("drawn", shown);
  };
  requestAnimationFrame(tell);
}

function showReadings() {
  const readings = (state.readings ?? []).filter(([name]) => !state.without?.includes(name));
  const row = $("readings");
  if (row.children.length !== readings.length)
    row.replaceChildren(...readings.map(() => {
      const each = document.createElement("div");
      each.append(document.createElement("label"), document.createElement("b"), "");
      return each;
    }));
  row.hidden = !readings.length;
  row.style.gridTemplateColumns = `repeat(${readings.length > 6 ? 4 : readings.length}, 1fr)`;
  readings.forEach(([name, label, value, unit], n) => {
    const [title, number] = row.children[n].children;
    if (title.textContent !== label) title.textContent = label;
    if (number.textContent !== value) number.textContent = value;
    number.id = name;
    row.children[n].lastChild.textContent = unit;
  });
  const lines = Object.entries(state.lines ?? {});
  text("lines", lines.length
    ? `lines followed: ${lines.map(([name, count]) => `${count} ${KINDS[name]}`).join(", ")}` : "");
}

function describe() {
  described = JSON.parse(link.described.tags[0]);
  build();
}

function gone() {
  connected = false;
  $("gone").hidden = false;
  $("mark").style.opacity = $("word").style.opacity = 0.5;
  $("report").hidden = true; // nothing serves it any more
  // The world says so, too, over its own buttons.
  $("world").firstElementChild.contentDocument?.getElementById("status-message")?.remove();
  const again = setInterval(() => fetch(location.href).then((answer) => {
    if (answer.ok) { clearInterval(again); location.reload(); }
  }, () => {}), 3000);
}

function start(...given) {
  [link, grey, figures] = given;
  [link, figures] = [plain(link), plain(figures)];
  link.state.properties.tags.change.connect(receive);
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
  // A kept world plays by itself once it has loaded, which takes a while.
  setInterval(() => { if (frame.contentWindow.viewer?.animator?.playing) seek(frame); }, 300);
  describe();
  receive();
  document.body.dataset.ready = "";
}
