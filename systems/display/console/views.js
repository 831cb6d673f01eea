// World, slices and strips.

// Strips

function showStrips({ columns, anew, keep }) {
  const { data_source: source } = figures.mode.renderers[0];
  for (const values of Object.values(columns))
    values.forEach((value, n) => { values[n] = value ?? NaN; });
  if (anew) source.data = columns;
  else source.stream(columns, keep, { sync: false });
}

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

let wound = null;
function seek(frame) {
  const animator = frame.contentWindow.viewer?.animator;
  // Each recording that is loaded has a mixer of its own.
  const at = state.seek ?? (state.ended && wound !== animator?.mixer ? Infinity : null);
  if (at == null || !(animator?.duration > 0)) return;
  wound = animator.mixer; // at the end of a run it shows the end, until somebody plays it
  if (animator.playing) animator.pause();
  frame.contentWindow.viewer.set_property(["phase"], "visible", false); // it is said beside it
  animator.seek(Math.min(at, animator.duration));
}

// Slices

// Charts of a deflection

let charted = false;
function showPaths(paths) {
  charted = Boolean(paths.depth);
  if (!charted) return;
  let [low, high, end] = [-1, 1, 10];
  for (const axis of ["x", "y"])
    for (const { name, data_source: source } of figures[`chart_${axis}`].renderers) {
      if (!name) continue;
      const prefix = name === "path" ? "" : `${name}_`;
      source.data = Object.fromEntries(Object.keys(plain(source.data)).map(
        (column) => [column, (paths[prefix + column] ?? []).map((value) => value ?? NaN)]));
      for (const [column, values] of Object.entries(source.data))
        for (const value of values.filter(Number.isFinite))
          if (column === "depth") end = Math.max(end, value);
          else [low, high] = [Math.min(low, value), Math.max(high, value)];
    }
  const margin = 0.08 * (high - low), { x_range: depth, y_range: range } = figures.chart_x;
  depth.setv({ start: 0, end });
  range.setv({ start: low - margin, end: high + margin });
}

let slices = [];
function showPictures({ pictures, colour, dash, paths }, images) {
  showPaths(paths);
  slices = pictures;
  slices.forEach((picture, n) => {
    const plot = figures[`slice_${n}`], [image, rails, ring, others] = plot.renderers;
    const one = (value) => (picture ? [value] : []);
    const { corner: [x, y], size: [dw, dh], rails: lines, tip, lines: followed } =
      picture ?? { corner: [], size: [], rails: [], tip: [], lines: [] };
    image.data_source.data = { image: picture ? [images.shift()] : [],
      x: one(x), y: one(y), dw: one(dw), dh: one(dh) };
    rails.data_source.data = { xs: lines.map(([xs]) => xs), ys: lines.map(([, ys]) => ys) };
    ring.data_source.data = { x: tip.slice(0, 1), y: tip.slice(1) };
    others.data_source.data = { colour: followed.map(([colour]) => colour),
      xs: followed.map(([, xs]) => xs), ys: followed.map(([, , ys]) => ys) };
    for (const { glyph } of [rails, ring])
      glyph.setv({ line_color: { value: colour }, line_dash: { value: dash } });
    if (picture) [plot.below[0].axis_label, plot.left[0].axis_label] = picture.axes;
  });
  document.querySelectorAll(".slice .title").forEach((each, n) => {
    each.textContent = slices[n]?.title ?? "";
  });
}

function fit() {
  slices.forEach((picture, n) => {
    if (!picture) return;
    const [left, right, top, bottom] = picture.window;
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
  if (state.without?.includes("planes")) return;
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
      if (/rails|ring|lines/.test(each.name ?? "")) each.visible = on;
}
