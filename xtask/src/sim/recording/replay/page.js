"use strict";
(() => {
  const one = (id) => document.getElementById(id);

  // ---- data -------------------------------------------------------------------

  async function load() {
    const text = one("data").textContent.trim();
    const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    const length = new DataView(bytes.buffer).getUint32(0, true);
    const run = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
    const behind = bytes.subarray(4 + length);
    run.columns = new Map(run.columns.map(([name, from, to]) => [name, behind.subarray(from, to)]));
    return run;
  }

  // Numbers of seven bits a byte, the lowest first; `rising` adds them up.
  function numbers(bytes, scale, rising) {
    let count = 0;
    for (const byte of bytes) if (byte < 0x80) count++;
    const values = new Float64Array(count);
    let at = 0, sum = 0;
    for (let i = 0; i < count; i++) {
      let value = 0, factor = 1, byte;
      do {
        byte = bytes[at++];
        value += (byte & 0x7f) * factor;
        factor *= 128;
      } while (byte >= 0x80);
      sum = rising ? sum + value : value;
      values[i] = sum * scale;
    }
    return values;
  }

  // Index of the first value above `limit`.
  function above(values, limit) {
    let low = 0, high = values.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (values[middle] <= limit) low = middle + 1; else high = middle;
    }
    return low;
  }

  function signals(message, data) {
    let little = 0n, big = 0n;
    for (let i = 0; i < 8; i++) {
      const byte = BigInt(data[i] ?? 0);
      little |= byte << BigInt(8 * i);
      big = (big << 8n) | byte;
    }
    return message.fields.map((field) => {
      const size = BigInt(field.size);
      let raw = ((field.big ? big : little) >> BigInt(field.shift)) & ((1n << size) - 1n);
      if (field.signed && raw >> (size - 1n)) raw -= 1n << size;
      const name = field.names[raw.toString()];
      const value = Number(raw) * field.factor + field.offset;
      const shown = name ?? value.toFixed(field.decimals) + (field.unit ? " " + field.unit : "");
      return field.name + " " + shown;
    });
  }

  // ---- drawing ----------------------------------------------------------------

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  let colours = {};
  function readColours() {
    for (const name of ["ink", "soft", "page", "grid", "line", "blue", "orange", "green", "shade", "bad"])
      colours[name] = colour("--" + name);
  }
  // Colours of nodes and tasks, distinguishable for colour-blind readers (after Okabe and Ito).
  const PALETTE = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#8c7a00", "#7a5195"];
  const paint = (index) => PALETTE[index % PALETTE.length];

  function surface(canvas) {
    const ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth || canvas.width;
    const height = Number(canvas.dataset.height) || width * canvas.dataset.aspect || canvas.height;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.font = "12px system-ui, sans-serif";
    return { context, width, height };
  }

  // Values of a legible distance within a span.
  function ticks(from, to, most) {
    const raw = (to - from) / Math.max(most, 1);
    const power = 10 ** Math.floor(Math.log10(raw || 1));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= raw) ?? power * 10;
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const all = [];
    for (let value = Math.ceil(from / step - 1e-9) * step; value <= to + step * 1e-9; value += step)
      all.push([value, (Math.abs(value) < step * 1e-9 ? 0 : value).toFixed(digits)]);
    return all;
  }

  // ---- the run ----------------------------------------------------------------

  load().then(start).catch((error) => {
    document.body.dataset.state = "failed";
    const trouble = one("trouble");
    trouble.hidden = false;
    trouble.textContent = typeof DecompressionStream === "undefined"
      ? "This browser is too old to unpack the run: one with DecompressionStream is needed."
      : "The data of this page cannot be read: " + error;
  });

  function start(run) {
    const end = run.end;
    const cycles = numbers(run.columns.get("cycles"), 1e-7, true);
    const frames = {
      start: numbers(run.columns.get("start"), 1e-7, true),
      span: numbers(run.columns.get("span"), 1e-7, false),
      id: numbers(run.columns.get("id"), 1, false),
      flags: run.columns.get("flags"),
      sender: run.columns.get("sender"),
      data: run.columns.get("data"),
    };
    frames.place = new Uint32Array(frames.flags.length + 1);
    for (let i = 0; i < frames.flags.length; i++) frames.place[i + 1] = frames.place[i] + (frames.flags[i] & 0x0f);
    const tasks = run.nodes.map((node, index) => ({
      node,
      names: run.tasks[index],
      from: numbers(run.columns.get("from " + node), 1e-6, true),
      length: numbers(run.columns.get("for " + node), 1e-7, false),
      task: run.columns.get("task " + node),
    }));
    const messages = new Map(run.messages.map((message) => [message.id, message]));
    const columns = new Map((run.states ?? []).map((column) => [column.name, column]));
    const times = columns.get("time_s")?.values ?? [];

    let now = 0, playing = false, last = 0;

    const value = (name, at) => {
      const column = columns.get(name);
      return column ? column.values[Math.max(0, above(times, at) - 1)] : undefined;
    };
    const latest = (list, at) => {
      let low = 0, high = list.length;
      while (low < high) {
        const middle = (low + high) >> 1;
        if (list[middle][0] <= at) low = middle + 1; else high = middle;
      }
      return low - 1;
    };

    // ---- track --------------------------------------------------------------

    const [right, up] = columns.has("east_m") ? ["east_m", "north_m"] : ["x_m", "y_m"];
    const hasTrack = columns.has(right);
    one("track-figure").hidden = !hasTrack;
    one("track").dataset.aspect = 0.75;
    let follow = false;

    // Fence, path and what was worked until now.
    function ground(c, at, scale) {
      const { fence, path, width, worked } = run.mission;
      const lines = (places) => {
        c.beginPath();
        places.forEach(([north, east], i) => c[i ? "lineTo" : "moveTo"](...at(east, north)));
      };
      if (fence.length) {
        lines(fence); c.closePath();
        c.strokeStyle = colours.ink; c.lineWidth = 1.5; c.stroke();
      }
      if (width) {
        c.strokeStyle = colours.green; c.globalAlpha = 0.18; c.lineWidth = width * scale;
        for (const part of worked) {
          const done = part.filter(([, , when]) => when <= now);
          if (done.length > 1) { lines(done); c.stroke(); }
        }
        c.globalAlpha = 1;
      }
      c.strokeStyle = colours.orange; c.setLineDash([7, 4]); c.lineWidth = 1;
      for (const places of path) { lines(places); c.stroke(); }
      c.setLineDash([]);
    }

    function track() {
      if (!hasTrack) return;
      const { context: c, width, height } = surface(one("track"));
      const xs = columns.get(right).values, ys = columns.get(up).values;
      const flip = up === "north_m" ? -1 : 1;
      let box = [Infinity, Infinity, -Infinity, -Infinity];
      const widen = (x, y) => {
        box = [Math.min(box[0], x), Math.min(box[1], y), Math.max(box[2], x), Math.max(box[3], y)];
      };
      xs.forEach((x, i) => widen(x, ys[i]));
      for (const [north, east] of [...(run.mission?.fence ?? []), ...(run.mission?.path ?? []).flat()]) widen(east, north);
      const place = [value(right, now), value(up, now)];
      if (follow) box = [place[0] - 4, place[1] - 3, place[0] + 4, place[1] + 3];
      const span = Math.max(box[2] - box[0], (box[3] - box[1]) * (width / height), 1) * 1.12;
      const scale = width / span;
      const middle = [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2];
      const at = (x, y) => [width / 2 + (x - middle[0]) * scale, height / 2 + flip * (y - middle[1]) * scale];
      c.strokeStyle = colours.grid;
      c.fillStyle = colours.soft;
      for (const [x, label] of ticks(middle[0] - span / 2, middle[0] + span / 2, 6)) {
        const [px] = at(x, 0);
        c.beginPath(); c.moveTo(px, 0); c.lineTo(px, height); c.stroke();
        c.fillText(label + " m", px + 3, height - 5);
      }
      const tall = span * height / width;
      for (const [y, label] of ticks(middle[1] - tall / 2, middle[1] + tall / 2, 5)) {
        const [, py] = at(0, y);
        c.beginPath(); c.moveTo(0, py); c.lineTo(width, py); c.stroke();
        c.fillText(label + " m", 3, py - 3);
      }
      if (run.line) {
        const [n0, e0, n1, e1] = run.line;
        c.strokeStyle = colours.orange; c.setLineDash([7, 4]); c.lineWidth = 1.5;
        c.beginPath(); c.moveTo(...at(e0, n0)); c.lineTo(...at(e1, n1)); c.stroke(); c.setLineDash([]);
      }
      if (run.mission) ground(c, at, scale);
      const until = above(times, now);
      const draw = (from, to, style) => {
        c.strokeStyle = style; c.lineWidth = 1.5; c.beginPath();
        for (let i = from; i < to; i++) c[i === from ? "moveTo" : "lineTo"](...at(xs[i], ys[i]));
        c.stroke();
      };
      draw(Math.max(0, until - 1), xs.length, colours.line);
      draw(0, until, colours.blue);
      const heading = (value("heading_deg", now) ?? value("heading_error_deg", now) ?? 0) * Math.PI / 180;
      const direction = flip < 0 ? [Math.sin(heading), -Math.cos(heading)] : [Math.cos(heading), Math.sin(heading)];
      const [px, py] = at(...place);
      c.fillStyle = colours.ink;
      c.beginPath();
      c.moveTo(px + 12 * direction[0], py + 12 * direction[1]);
      c.lineTo(px - 7 * direction[0] + 6 * direction[1], py - 7 * direction[1] - 6 * direction[0]);
      c.lineTo(px - 7 * direction[0] - 6 * direction[1], py - 7 * direction[1] + 6 * direction[0]);
      c.fill();
      one("track").setAttribute("aria-label",
        `Track: the vehicle is at ${place.map((v) => v?.toFixed(2)).join(" m, ")} m`);
    }
    one("track").addEventListener("click", () => { follow = !follow; update(); });
  
    // ---- charts over time ---------------------------------------------------

    const CHARTS = [
      ["Cross-track error", "m", [["cross_track_error_m", "true", "blue"],
        ["estimated_cross_track_error_m", "estimated", "green"], ["measured_cross_track_error_m", "measured", "orange"]]],
      ["Offset from the middle of the row", "m", [["right_m", "true", "blue"]]],
      ["Distances to the rows", "m", [["left_sensor_m", "left", "blue"], ["right_sensor_m", "right", "orange"]]],
      ["Steering angle", "deg", [["steering_angle_deg", "true", "blue"]]],
      ["Heading against the line", "deg", [["heading_error_deg", "true", "blue"]]],
      ["Speed", "m/s", [["speed_m_s", "true", "blue"]]],
      ["Efforts of the sides", "", [["left_effort", "left", "blue"], ["right_effort", "right", "orange"]]],
    ];
    const charts = CHARTS
      .map(([title, unit, series]) => [title, unit, series.filter(([name]) => columns.has(name))])
      .filter(([, , series]) => series.length)
      .map(([title, unit, series]) => ({
        title, unit,
        series: series.map(([name, label, style]) => ({ label, style, x: times, y: columns.get(name).values })),
      }));
    const efforts = run.nodes
      .map((node, index) => [node, index, run.efforts.filter((change) => change[1] === node)])
      .filter(([, , changes]) => changes.length);
    if (efforts.length) {
      charts.push({
        title: "Efforts of the motors", unit: "",
        series: efforts.map(([node, index, changes]) => {
          const x = [0], y = [0];
          for (const [at, , effort] of changes) { x.push(at, at); y.push(y[y.length - 1], effort); }
          x.push(end); y.push(y[y.length - 1]);
          return { label: node, paint: paint(index), x, y };
        }),
      });
    }
    for (const chart of charts) {
      const canvas = document.createElement("canvas");
      canvas.dataset.height = 110;
      canvas.style.height = "110px";
      canvas.setAttribute("role", "img");
      one("plots").append(canvas);
      chart.canvas = canvas;
      const all = chart.series.flatMap((series) => series.y).filter((v) => v !== null);
      const [least, most] = all.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [0, 0]);
      const room = (most - least || 1) * 0.06;
      chart.y = [least - room, most + room];
      canvas.addEventListener("click", (event) => {
        const box = canvas.getBoundingClientRect();
        const [from, to] = shown();
        seek(from + (event.clientX - box.left - 56) / (box.width - 64) * (to - from));
      });
    }
    if (!charts.length) one("plots").textContent = "This run has no states.";

    // All of a short run, else a minute around now.
    function shown() {
      const span = Math.min(end, 60);
      const from = Math.min(Math.max(0, now - span / 2), end - span);
      return [from, from + span];
    }

    function plot(chart) {
      const { context: c, width, height } = surface(chart.canvas);
      const [from, to] = shown();
      const [low, high] = chart.y;
      const x = (t) => 56 + (t - from) / (to - from) * (width - 64);
      const y = (v) => height - 18 - (v - low) / (high - low) * (height - 36);
      for (const [at, , automatic, until] of modes)
        if (automatic && until > from && at < to) {
          c.fillStyle = colours.shade;
          c.fillRect(x(Math.max(at, from)), 18, x(Math.min(until, to)) - x(Math.max(at, from)), height - 36);
        }
      c.strokeStyle = colours.grid; c.fillStyle = colours.soft; c.lineWidth = 1;
      for (const [v, label] of ticks(low, high, 4)) {
        c.beginPath(); c.moveTo(56, y(v)); c.lineTo(width - 8, y(v)); c.stroke();
        c.textAlign = "right"; c.fillText(label, 52, y(v) + 4);
      }
      c.textAlign = "center";
      for (const [t, label] of ticks(from, to, width / 90)) {
        c.beginPath(); c.moveTo(x(t), 18); c.lineTo(x(t), height - 18); c.stroke();
        c.fillText(label + " s", x(t), height - 4);
      }
      c.textAlign = "left"; c.fillStyle = colours.ink;
      const unit = chart.unit ? ` (${chart.unit})` : "";
      c.fillText(chart.title + unit, 58, 12);
      let place = 58 + c.measureText(chart.title + unit).width + 14;
      const texts = [];
      c.save(); c.beginPath(); c.rect(56, 0, width - 64, height); c.clip();
      for (const series of chart.series) {
        const style = series.paint ?? colours[series.style];
        c.strokeStyle = style; c.lineWidth = 1.4; c.beginPath();
        const begin = Math.max(0, above(series.x, from) - 1);
        const after = Math.min(series.x.length, above(series.x, to) + 1);
        const every = Math.max(1, Math.floor((after - begin) / (2 * width)));
        let pen = false;
        for (let i = begin; i < after; i += series.paint ? 1 : every) {
          const v = series.y[i];
          if (v === null) { pen = false; continue; }
          c[pen ? "lineTo" : "moveTo"](x(series.x[i]), y(v));
          pen = true;
        }
        c.stroke();
        const v = series.y[Math.max(0, above(series.x, now) - 1)];
        const text = `${series.label} ${v === null || v === undefined ? "–" : v.toFixed(3)}`;
        texts.push(text);
        c.fillStyle = style; c.fillText(text, place, 12);
        place += c.measureText(text).width + 14;
      }
      c.restore();
      c.strokeStyle = colours.ink; c.lineWidth = 1;
      c.beginPath(); c.moveTo(x(now), 14); c.lineTo(x(now), height - 18); c.stroke();
      chart.canvas.setAttribute("aria-label", `${chart.title}${unit} at ${now.toFixed(2)} s: ${texts.join(", ")}`);
    }

    // ---- modes and events ---------------------------------------------------

    const modes = run.modes.map(([at, mode, automatic], index) =>
      [at, mode, automatic, run.modes[index + 1]?.[0] ?? end]);
    for (const [at, text] of run.events) {
      const option = document.createElement("option");
      option.value = at;
      option.textContent = `${at.toFixed(3)} s: ${text}`;
      one("events").append(option);
    }
    one("events").addEventListener("change", (event) => {
      if (event.target.value !== "") seek(Number(event.target.value));
    });

    const tiles = new Map();
    function tile(name, text) {
      if (!tiles.has(name)) {
        const box = document.createElement("div");
        const term = document.createElement("dt"), what = document.createElement("dd");
        term.textContent = name;
        box.append(term, what);
        one("now").append(box);
        tiles.set(name, what);
      }
      const what = tiles.get(name);
      if (what.textContent !== text) what.textContent = text;
    }

    function figures() {
      const mode = latest(modes, now);
      if (modes.length) tile("mode", mode < 0 ? "not told yet" : modes[mode][1]);
      for (const [name, label, digits, scale, unit] of [
        ["cross_track_error_m", "cross-track error", 2, 100, "cm"], ["right_m", "offset", 2, 100, "cm"],
        ["speed_m_s", "speed", 2, 1, "m/s"], ["steering_angle_deg", "steering angle", 1, 1, "deg"],
        ["heading_error_deg", "heading error", 2, 1, "deg"]]) {
        const v = value(name, now);
        if (typeof v === "number") tile(label, (v * scale).toFixed(digits) + " " + unit);
      }
      const fix = value("fix", now);
      if (fix) tile("fix", fix);
      for (const node of run.nodes) {
        const change = run.relays.filter((one) => one[1] === node);
        const index = latest(change, now);
        if (change.length) tile("relay of " + node, index >= 0 && change[index][2] ? "closed" : "open");
      }
      const event = latest(run.events, now);
      tile("last event", event < 0 ? "none yet" : run.events[event][1]);
    }

    one("display-section").hidden = run.screens.length === 0;
    function display() {
      const index = latest(run.screens, now);
      const rows = index < 0 ? [] : run.screens[index][1].split("\n");
      one("display").textContent = [0, 1, 2, 3].map((i) => (rows[i] ?? "").padEnd(20)).join("\n");
      one("lamps").textContent = rows[4] ? "Lamps: " + rows[4] : "";
    }

    // ---- logs ---------------------------------------------------------------

    run.texts.forEach((text, index) => {
      const option = document.createElement("option");
      option.value = index;
      option.textContent = text.name;
      one("source").append(option);
    });
    one("source").addEventListener("change", () => update());
    let written = "";
    function lines() {
      const text = run.texts[Number(one("source").value) || 0];
      if (!text) { one("texts").textContent = "The nodes wrote nothing."; return; }
      const until = latest(text.lines, now) + 1;
      const key = text.name + until;
      if (key === written) return;
      written = key;
      one("texts").textContent = text.lines.slice(Math.max(0, until - 300), until)
        .map(([at, line]) => at.toFixed(3).padStart(10) + " " + line).join("\n");
      one("texts").scrollTop = one("texts").scrollHeight;
    }

    // ---- basic cycle --------------------------------------------------------

    const canvas = one("cycle");
    const LANE = 26, AXIS = 22, LABEL = 92;
    canvas.dataset.height = AXIS + LANE * (run.nodes.length + 1) + 26;
    canvas.style.height = canvas.dataset.height + "px";
    let cycle = -1, hits = [];

    // Windows of a cycle, by the count that its reference tells.
    function windowsOf(index) {
      const reference = run.windows.find((window) => window.kind === "reference");
      if (!reference) return [];
      const count = countOf(index);
      return run.windows.filter((window) =>
        window.kind === "reference" || count === null || count % window.repeat === window.offset);
    }
    function countOf(index) {
      const first = above(frames.start, cycles[index] - 1e-6);
      // A cycle whose reference did not come has no count.
      if (!(Math.abs(frames.start[first] - cycles[index]) < 1e-6) || !(frames.flags[first] & 0x80)) return null;
      const message = messages.get(frames.id[first]);
      const field = message?.fields.find((one) => one.name === "CycleCount");
      if (!field) return null;
      const text = signals({ fields: [field] }, frames.data.subarray(frames.place[first], frames.place[first + 1]))[0];
      return Number(text.split(" ")[1]);
    }

    function span() {
      const from = cycles[cycle], to = cycles[cycle + 1] ?? end;
      const whole = to - from;
      const width = whole / 2 ** Number(one("zoom").value);
      const begin = from + Number(one("place").value) * (whole - width);
      return [begin, begin + width];
    }

    function timeline() {
      const { context: c, width, height } = surface(canvas);
      if (cycle < 0) return;
      hits = [];
      const [from, to] = span();
      const x = (t) => LABEL + (t - from) / (to - from) * (width - LABEL - 8);
      const zero = cycles[cycle];
      c.fillStyle = colours.soft; c.strokeStyle = colours.grid;
      for (const [us, label] of ticks((from - zero) * 1e6, (to - zero) * 1e6, width / 110)) {
        const px = x(zero + us / 1e6);
        c.beginPath(); c.moveTo(px, AXIS - 6); c.lineTo(px, height - 22); c.stroke();
        c.textAlign = "center"; c.fillText(label + " us", px, 12);
      }
      c.textAlign = "right";
      ["bus", ...run.nodes].forEach((name, lane) => {
        c.fillStyle = lane ? paint(lane - 1) : colours.ink;
        c.fillText(name, LABEL - 8, AXIS + LANE * lane + 17);
        c.strokeStyle = colours.line;
        c.beginPath(); c.moveTo(LABEL, AXIS + LANE * (lane + 1) - 2); c.lineTo(width - 8, AXIS + LANE * (lane + 1) - 2); c.stroke();
      });
      c.save(); c.beginPath(); c.rect(LABEL, 0, width - LABEL - 8, height); c.clip();
      const box = (t, until, lane, style, text, what, frame) => {
        const left = x(t), wide = Math.max(x(until) - left, 0.8), top = AXIS + LANE * lane + 3;
        if (left > width || left + wide < LABEL) return;
        c.fillStyle = style;
        if (frame) { c.strokeStyle = style; c.strokeRect(left + 0.5, top - 1.5, wide - 1, LANE - 6); }
        else c.fillRect(left, top + 2, wide, LANE - 12);
        if (!frame && wide > c.measureText(text).width + 6) {
          c.fillStyle = "#fff"; c.textAlign = "left"; c.fillText(text, left + 3, top + LANE - 15);
        }
        hits.push([left, left + wide, lane, what, frame]);
      };
      for (const window of windowsOf(cycle)) {
        const begin = zero + window.start / 1e6;
        box(begin, begin + window.length / 1e6, 0, window.kind === "arbitrating" ? colours.line : colours.blue,
          window.message, `window of ${window.message} (${window.kind}), ${window.start} us to ${window.start + window.length} us`, true);
      }
      for (let i = above(frames.start, from - 0.003); i < frames.start.length && frames.start[i] < to; i++) {
        const name = messages.get(frames.id[i])?.name ?? String(frames.id[i]);
        const sender = run.senders[frames.sender[i]];
        const complete = frames.flags[i] & 0x80;
        const style = complete ? (frames.sender[i] < run.nodes.length ? paint(frames.sender[i]) : colours.ink) : colours.orange;
        box(frames.start[i], frames.start[i] + frames.span[i], 0, style, name,
          `${name} of ${sender} at ${((frames.start[i] - zero) * 1e6).toFixed(1)} us, ${(frames.span[i] * 1e6).toFixed(1)} us long${complete ? "" : ", destroyed"}`);
      }
      tasks.forEach((task, index) => {
        for (let i = above(task.from, from - 0.01); i < task.from.length && task.from[i] < to; i++) {
          const name = task.names[task.task[i]] ?? "exception " + task.task[i];
          box(task.from[i], task.from[i] + task.length[i], index + 1, paint(task.task[i]), name,
            `${task.node}: ${name} at ${((task.from[i] - zero) * 1e6).toFixed(0)} us for ${(task.length[i] * 1e6).toFixed(1)} us`);
        }
      });
      c.strokeStyle = colours.ink; c.beginPath(); c.moveTo(x(now), AXIS - 6); c.lineTo(x(now), height - 22); c.stroke();
      c.restore();
      canvas.setAttribute("aria-label",
        `Basic cycle ${cycle}, ${((from - zero) * 1e6).toFixed(0)} us to ${((to - zero) * 1e6).toFixed(0)} us; the frames are in the table below`);
    }

    function hit(event) {
      const box = canvas.getBoundingClientRect();
      const px = event.clientX - box.left, lane = Math.floor((event.clientY - box.top - AXIS) / LANE);
      const near = hits.filter(([left, to, row]) => row === lane && px >= left - 2 && px <= to + 2);
      return (near.find(([, , , , frame]) => !frame) ?? near[0])?.[3] ?? "";
    }
    canvas.addEventListener("pointermove", (event) => { canvas.title = hit(event); });
    canvas.addEventListener("click", (event) => { one("under").textContent = hit(event); });

    function table() {
      const body = one("frames").tBodies[0];
      body.replaceChildren();
      const from = cycles[cycle] - 1e-7, to = cycles[cycle + 1] ?? end;
      const windows = windowsOf(cycle);
      for (let i = above(frames.start, from); i < frames.start.length && frames.start[i] < to - 1e-7; i++) {
        const at = (frames.start[i] - cycles[cycle]) * 1e6;
        const id = frames.id[i];
        const message = messages.get(id);
        const data = frames.data.subarray(frames.place[i], frames.place[i + 1]);
        const own = windows.filter((window) => window.id === id)
          .sort((a, b) => Math.abs(at - a.start) - Math.abs(at - b.start))[0];
        const complete = frames.flags[i] & 0x80;
        const row = body.insertRow();
        if (!complete || !message || frames.sender[i] >= run.nodes.length) row.className = "bad";
        const cells = [
          [at.toFixed(1)], [message?.name ?? "unknown", "word"], [String(id)], [run.senders[frames.sender[i]], "word"],
          [own && own.kind !== "arbitrating" ? (Math.round((at - own.start) * 10) / 10 + 0).toFixed(1) : "–"],
          [[...data].map((byte) => byte.toString(16).toUpperCase().padStart(2, "0")).join(" "), "word"],
          [contents(i, message, data), "what"],
        ];
        for (const [text, style] of cells) {
          const cell = row.insertCell();
          cell.textContent = text;
          if (style) cell.className = style;
        }
      }
    }

    function contents(i, message, data) {
      if (!(frames.flags[i] & 0x80)) return "destroyed by an error frame";
      if (frames.flags[i] & 0x40) return "remote frame: it asks for the message";
      if (!message) return "";
      if (!message.lengths.includes(data.length)) return `${data.length} bytes: not the length of the message`;
      return signals(message, data).join(", ");
    }

    function basicCycle(force) {
      const index = Math.min(Math.max(0, above(cycles, now + 1e-9) - 1), cycles.length - 2);
      const changed = index !== cycle;
      cycle = index;
      if (changed || force) {
        one("cycle-name").textContent =
          `${cycle}${countOf(cycle) === null ? "" : ", count " + countOf(cycle)}, from ${cycles[cycle].toFixed(4)} s`;
      }
      // While it plays fast, the table would change faster than anybody reads.
      if ((changed || force) && (!playing || Number(one("speed").value) <= 0.1)) table();
      timeline();
    }

    // ---- time ---------------------------------------------------------------

    function update(force) {
      one("clock").textContent = now.toFixed(3) + " s of " + (end < 0.1 ? end : end.toFixed(1)) + " s";
      one("time").value = now;
      one("time").setAttribute("aria-valuetext", now.toFixed(2) + " seconds");
      figures();
      display();
      lines();
      track();
      charts.forEach(plot);
      basicCycle(force);
    }

    function seek(time) {
      now = Math.min(Math.max(0, time), end);
      update();
    }

    function play(on) {
      if (on && now >= end) now = 0;
      playing = on;
      one("play").textContent = playing ? "Pause" : "Play";
      last = performance.now();
      if (playing) requestAnimationFrame(frame);
      else update(true);
    }
    function frame(at) {
      if (!playing) return;
      now = Math.min(end, now + Math.max(0, at - last) / 1000 * Number(one("speed").value));
      last = at;
      if (now >= end) { play(false); return; }
      update();
      requestAnimationFrame(frame);
    }

    one("time").max = end;
    one("time").addEventListener("input", (event) => seek(Number(event.target.value)));
    one("play").addEventListener("click", () => play(!playing));
    for (const id of ["zoom", "place"]) one(id).addEventListener("input", timeline);
    const step = (by) => seek(cycles[Math.min(Math.max(0, cycle + by), cycles.length - 2)]);
    one("previous").addEventListener("click", () => step(-1));
    one("next").addEventListener("click", () => step(1));
    document.addEventListener("keydown", (event) => {
      if (event.target.closest("select, input, summary, pre, .scroll")) return;
      const shift = event.shiftKey;
      const nudge = (by) => { one("place").value = Number(one("place").value) + by / 2 ** Number(one("zoom").value); timeline(); };
      const scale = (by) => { one("zoom").value = Number(one("zoom").value) + by; timeline(); };
      const actions = {
        " ": event.target.tagName === "BUTTON" ? null : () => play(!playing),
        ArrowLeft: () => (event.target === canvas && shift ? nudge(-0.25) : seek(now - (shift ? 1 : 0.1))),
        ArrowRight: () => (event.target === canvas && shift ? nudge(0.25) : seek(now + (shift ? 1 : 0.1))),
        PageUp: () => step(-1), PageDown: () => step(1),
        Home: () => seek(0), End: () => seek(end),
        "+": () => scale(0.5), "-": () => scale(-0.5),
      };
      if (!event.ctrlKey && !event.metaKey && !event.altKey && actions[event.key]) {
        event.preventDefault();
        actions[event.key]();
      }
    });
    const redraw = () => { readColours(); update(true); };
    window.addEventListener("resize", redraw);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);

    readColours();
    // A time behind # in the address is where it begins.
    const wanted = Number(location.hash.slice(1));
    now = Number.isFinite(wanted) ? Math.min(Math.max(0, wanted), end) : 0;
    update(true);
    document.body.dataset.state = "ready";
  }
})();
