// Draws the moving slice on one canvas. The data are the JSON of `slice-data`; src/recording_page/film.rs says what they are.
(() => {
  "use strict";
  const figure = document.getElementById("slice");
  const film = JSON.parse(document.getElementById("slice-data").textContent);
  const find = (name) => figure.querySelector(`[data-part=${name}]`);
  const canvas = find("canvas"), slider = find("slider"), button = find("play"), words = find("words");
  const chooser = find("flow"), own = find("own"), points = find("points"), under = find("under"), save = find("save");
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  for (const channel of film.channels) channel.values = bytes(channel.codes);
  for (const dots of film.dots) {
    dots.values = new Uint16Array(bytes(dots.places).buffer);
    let first = 0;
    dots.first = dots.counts.map((count) => (first += count) - count);
  }
  const [columns, rows] = film.nodes, cells = columns * rows, last = film.moments.length - 1;
  const state = { frame: last, flow: Math.min(1, film.flows.length - 1), timer: 0 };

  // Colours: RdBu of ColorBrewer, viridis, and magma from light to dark.
  const stops = (text) => text.split(" ").map((hex) => [0, 2, 4].map((k) => parseInt(hex.slice(k, k + 2), 16)));
  const MAPS = {
    signed: stops("053061 2166ac 4393c3 92c5de d1e5f0 f7f7f7 fddbc7 f4a582 d6604d b2182b 67001f"),
    speed: stops("440154 472c7a 3b518b 2c718e 21908d 27ad81 5cc863 aadc32 fde725"),
    error: stops("fcfdbf feca8d fd9668 f1605d cd4071 9e2f7f 721f81 440f76 180f3d 000004"),
  };
  const NOTHING = [221, 221, 221];
  const colour = (map, share) => {
    const place = Math.min(Math.max(share, 0), 1) * (map.length - 1);
    const k = Math.min(Math.floor(place), map.length - 2), part = place - k;
    return map[k].map((low, c) => Math.round(low + part * (map[k + 1][c] - low)));
  };

  const raised = (text) => text.replace(/./g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]);
  const print = (x) => {
    if (x === 0) return "0";
    const size = Math.floor(Math.log10(Math.abs(x)));
    if (size >= -2 && size < 4) return String(Number(x.toPrecision(2))).replace("-", "−");
    const [digits, power] = x.toExponential(1).split("e");
    return `${digits.replace("-", "−")}·10${raised(String(Number(power)))}`;
  };
  const ticks = (length) => {
    const rough = length / 4, decade = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 2.5, 5, 10].find((k) => k * decade >= 0.999 * rough) * decade;
    return Array.from({ length: Math.floor(length / step + 1e-9) + 1 }, (_, k) => k * step);
  };

  const channel = (flow, quantity, difference) =>
    film.channels.find((c) => c.flow === flow && c.quantity === quantity && c.difference === difference);
  const panels = () => {
    const name = (k) => film.flows[k], k = state.flow, all = [];
    const add = (title, own, map, flow) => own && all.push({ title, channel: own, map, flow });
    for (const [quantity, symbol, map] of [["vorticity", "ω_z", MAPS.signed], ["speed", "|u|", MAPS.speed]]) {
      add(`${name(0)}: ${quantity} ${symbol}`, channel(0, quantity, false), map, 0);
      if (k === 0) continue;
      add(`${name(k)}: ${quantity} ${symbol}`, channel(k, quantity, false), map, k);
      add(`${name(k)} − ${name(0)}: ${quantity === "speed" ? "|Δu|" : "Δω_z"}`, channel(k, quantity, true), quantity === "speed" ? MAPS.error : map, -1);
    }
    return all;
  };

  const value = (panel, node) => {
    const { channel } = panel, code = channel.values[state.frame * cells + node], scale = channel.scales[state.frame];
    if (!code) return NaN;
    return channel.quantity === "speed" ? ((code - 1) / 254) * scale : ((code - 128) / 127) * scale;
  };
  // Flows share the scale of the first one.
  const range = (panel) => {
    const { channel: c } = panel, scale = (panel.flow < 0 ? c : channel(0, c.quantity, false)).scales[state.frame];
    return (own.checked ? scale : c.range) || 1;
  };
  const share = (panel, x) => (panel.channel.quantity === "speed" ? x / range(panel) : 0.5 + 0.5 * x / range(panel));
  const field = document.createElement("canvas");
  [field.width, field.height] = film.nodes;
  const paint = (panel) => {
    const context = field.getContext("2d"), image = context.createImageData(columns, rows);
    for (let node = 0; node < cells; node++) {
      const x = value(panel, node), up = rows - 1 - Math.floor(node / columns);
      image.data.set(Number.isNaN(x) ? NOTHING : colour(panel.map, share(panel, x)), 4 * (up * columns + (node % columns)));
      image.data[4 * (up * columns + (node % columns)) + 3] = 255;
    }
    context.putImageData(image, 0, 0);
  };

  // Places of the panels, in pixels of the page.
  const LEFT = 40, GAP = 26, TITLE = 22, AXIS = 20, BAR = 9, FOOT = 34;
  const layout = () => {
    const all = panels(), across = film.flows.length > 1 ? 3 : 2, width = canvas.parentElement.clientWidth;
    const ratio = film.sides[1] / film.sides[0];
    let wide = (width - LEFT - GAP * (across - 1) - 12) / across;
    wide = Math.min(wide, 460 / Math.max(ratio, 1e-9), 460);
    const high = wide * ratio, step = TITLE + high + AXIS + BAR + FOOT;
    all.forEach((panel, k) => {
      panel.x = LEFT + (k % across) * (wide + GAP);
      panel.y = TITLE + Math.floor(k / across) * step;
      [panel.wide, panel.high, panel.column] = [wide, high, k % across];
    });
    return { all, width, height: Math.ceil(all.length / across) * step };
  };

  const text = (pen, words, x, y, [align, size, tone]) => {
    [pen.textAlign, pen.font, pen.fillStyle] = [align, `${size}px Helvetica, Arial, sans-serif`, tone];
    // The only subscript is that of ω_z.
    const [base, rest] = words.split("_z");
    pen.fillText(base, x, y);
    if (rest === undefined) return;
    const end = x + pen.measureText(base).width;
    pen.font = `${size - 3}px Helvetica, Arial, sans-serif`;
    pen.fillText("z", end + 0.5, y + 3);
  };
  const axes = (pen, panel) => {
    const { x, y, wide, high } = panel;
    pen.strokeStyle = "#282828";
    pen.strokeRect(x, y, wide, high);
    for (const [k, side] of film.sides.entries()) {
      for (const at of ticks(side)) {
        const place = k ? y + high * (1 - at / side) : x + (wide * at) / side;
        pen.beginPath();
        if (k) { pen.moveTo(x - 4, place); pen.lineTo(x, place); } else { pen.moveTo(place, y + high); pen.lineTo(place, y + high + 4); }
        pen.stroke();
        if (!k) text(pen, print(at), place, y + high + 14, ["center", 11, "#282828"]);
        else if (panel.column === 0) text(pen, print(at), x - 7, place + 4, ["right", 11, "#282828"]);
      }
    }
    text(pen, "x", x + wide + 5, y + high + 4, ["left", 12, "#6e6e6e"]);
    if (panel.column === 0) text(pen, "y", x - 7, y - 3, ["right", 12, "#6e6e6e"]);
  };
  const bar = (pen, panel) => {
    const { x, wide } = panel, y = panel.y + panel.high + AXIS, speed = panel.channel.quantity === "speed", end = range(panel);
    for (let k = 0; k < wide; k++) {
      pen.fillStyle = `rgb(${colour(panel.map, k / (wide - 1))})`;
      pen.fillRect(x + k, y, 1.5, BAR);
    }
    const marks = speed ? [0, 0.5, 1] : [-1, 0, 1];
    marks.forEach((mark, k) =>
      text(pen, print(mark * end), x + (wide * k) / 2, y + BAR + 12, [["left", "center", "right"][k], 11, "#282828"]));
    if (panel.flow >= 0) return;
    const whole = channel(0, panel.channel.quantity, false).rms[state.frame];
    const part = panel.channel.rms[state.frame] / whole;
    const note = whole > 0 && Number.isFinite(part) ? `r.m.s. ${print(part)} of that of ${film.flows[0]}` : "";
    text(pen, note, x + wide / 2, y + BAR + 26, ["center", 11, "#6e6e6e"]);
  };
  const dot = (pen, panel) => {
    const dots = film.dots[panel.flow], first = dots.first[state.frame], count = dots.counts[state.frame];
    pen.fillStyle = "rgba(0, 0, 0, 0.6)";
    for (let k = first; k < first + count; k++) {
      const [u, v] = [dots.values[2 * k] / 65535, dots.values[2 * k + 1] / 65535];
      pen.beginPath();
      pen.arc(panel.x + u * panel.wide, panel.y + (1 - v) * panel.high, 1.2, 0, 7);
      pen.fill();
    }
  };

  let shown = { all: [] };
  const draw = () => {
    shown = layout();
    const sharp = window.devicePixelRatio || 1;
    canvas.width = Math.round(shown.width * sharp);
    canvas.height = Math.round(shown.height * sharp);
    canvas.style.height = `${shown.height}px`;
    const pen = canvas.getContext("2d");
    pen.scale(sharp, sharp);
    pen.fillStyle = "#fff";
    pen.fillRect(0, 0, shown.width, shown.height);
    pen.imageSmoothingQuality = "high";
    for (const panel of shown.all) {
      paint(panel);
      pen.drawImage(field, panel.x, panel.y, panel.wide, panel.high);
      if (points.checked && panel.flow >= 0) dot(pen, panel);
      axes(pen, panel);
      bar(pen, panel);
      text(pen, panel.title, panel.x, panel.y - 8, ["left", 13, "#282828"]);
      if (!panel.channel.there[state.frame]) text(pen, "no frame at this time", panel.x + panel.wide / 2, panel.y + panel.high / 2, ["center", 13, "#6e6e6e"]);
    }
    const now = film.moments[state.frame];
    const turns = now.turnovers === null ? "" : ` = ${now.turnovers.toFixed(3)} eddy times after the first frame`;
    words.textContent = `frame ${state.frame + 1} of ${last + 1}, step ${now.step}, t = ${Number(now.time.toPrecision(5))}${turns}`;
    slider.value = state.frame;
    figure.dataset.frame = state.frame + 1;
  };

  const go = (frame) => { state.frame = Math.min(Math.max(frame, 0), last); draw(); };
  const pause = () => { clearInterval(state.timer); state.timer = 0; button.textContent = "▶ play"; };
  const play = () => {
    const pace = Math.min(Math.max(8000 / (last + 1), 60), 500);
    button.textContent = "❚❚ pause";
    state.timer = setInterval(() => go(state.frame === last ? 0 : state.frame + 1), pace);
  };
  const linked = () => {
    const found = /frame=(\d+)/.exec(location.hash);
    if (found) go(Number(found[1]) - 1);
  };
  button.onclick = () => (state.timer ? pause() : play());
  slider.max = last;
  slider.oninput = () => { pause(); go(Number(slider.value)); };
  own.onchange = points.onchange = draw;
  if (chooser) chooser.onchange = () => { state.flow = Number(chooser.value); draw(); };
  canvas.onpointermove = (event) => {
    const [x, y] = [event.offsetX, event.offsetY];
    const panel = shown.all.find((p) => x >= p.x && x < p.x + p.wide && y >= p.y && y < p.y + p.high);
    if (!panel) { under.textContent = ""; return; }
    const u = (x - panel.x) / panel.wide, v = 1 - (y - panel.y) / panel.high;
    const node = Math.min(Math.floor(v * rows), rows - 1) * columns + Math.min(Math.floor(u * columns), columns - 1);
    const found = value(panel, node);
    under.textContent = `x = ${print(u * film.sides[0])}, y = ${print(v * film.sides[1])}: ${Number.isNaN(found) ? "no particle near" : print(found)}`;
  };
  save.onclick = () => { save.href = canvas.toDataURL("image/png"); save.download = `slice-${state.frame + 1}.png`; };
  window.onresize = draw;
  window.onhashchange = linked;
  draw();
  linked();
})();
