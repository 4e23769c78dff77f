"use strict";
// Draws path and points from above and from the side, and ties them to the pictures. No network, no library.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const canvases = [...document.querySelectorAll("canvas")];
  if (!canvases.length) return;
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  // bodies that move: their places one after the other, and where each one's begin
  const bodies = (moving) => {
    const whole = new Uint16Array(bytes(moving.places).buffer), starts = [0];
    moving.counts.forEach((n) => starts.push(starts[starts.length - 1] + n));
    return { ...moving, starts, at: (k) => [0, 1, 2].map((c) => moving.low[c] + moving.step[c] * whole[3 * k + c]) };
  };
  const parts = data.parts.map((part) => ({
    ...part,
    at: new Uint16Array(bytes(part.points).buffer),
    rgb: part.rgb ? bytes(part.rgb) : null,
    error: bytes(part.error),
    moving: part.moving && bodies(part.moving),
  }));
  const thumbOf = new Map(data.thumbs.map((t) => [t.view, t]));
  const state = { part: 0, colour: data.colours ? "picture" : "error", picked: -1, boxes: [], now: 0 };
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  // blue, green, yellow, red: small error to large
  const scale = [[40, 80, 200], [40, 170, 110], [240, 200, 40], [220, 40, 30]];
  const ramp = Array.from({ length: 256 }, (_, v) => {
    if (v === 255) return [128, 128, 128];
    const t = (v / 254) * 3, k = Math.min(2, Math.floor(t)), s = t - k;
    return scale[k].map((a, c) => Math.round(a + s * (scale[k + 1][c] - a)));
  });

  const shown = document.getElementById("shown");
  const reset = () => {
    const part = parts[state.part], drawn = part.at.length / 3;
    const said = [drawn, part.total].map((n) => n.toLocaleString("en"));
    shown.textContent = drawn < part.total ? `${said[0]} of ${said[1]} points drawn` : "";
    state.boxes = parts[state.part].boxes.map((b) => [...b]);
    begin();
  };
  const pixels = (canvas, side) => {
    const [left, low, right, high] = state.boxes[side];
    const per = Math.min(canvas.width / (right - left), canvas.height / (high - low));
    const x = canvas.width / 2 - (per * (left + right)) / 2, y = canvas.height / 2 + (per * (low + high)) / 2;
    return { per, x, y, to: (p) => [x + per * p[0], y - per * p[1]] };
  };
  const flat = (place, side) => {
    const axes = parts[state.part].axes[side];
    return [0, 1].map((k) => axes[k].reduce((sum, a, c) => sum + a * place[c], 0));
  };

  function draw(canvas, side) {
    const part = parts[state.part], ratio = Math.max(1, window.devicePixelRatio || 1);
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    const pen = canvas.getContext("2d"), view = pixels(canvas, side), n = part.at.length / 3;
    const size = Math.max(1, Math.min(3, 260 / Math.sqrt(n + 1))) * ratio;
    pen.clearRect(0, 0, canvas.width, canvas.height);
    // dark points on dark paper, and light ones on light, would vanish
    const lift = matchMedia("(prefers-color-scheme: dark)").matches ? (v) => 48 + 0.81 * v : (v) => 0.86 * v;
    pen.globalAlpha = state.colour === "picture" ? 0.95 : 0.75;
    const [low, step] = [part.low, part.step];
    for (let k = 0; k < n; k++) {
      const place = [0, 1, 2].map((c) => low[c] + step[c] * part.at[3 * k + c]);
      const [x, y] = view.to(flat(place, side));
      if (x < 0 || y < 0 || x > canvas.width || y > canvas.height) continue;
      const pictured = state.colour === "picture" && part.rgb;
      const colour = pictured ? [0, 1, 2].map((c) => lift(part.rgb[3 * k + c])) : ramp[part.error[k]];
      pen.fillStyle = `rgb(${colour[0]},${colour[1]},${colour[2]})`;
      pen.fillRect(x - size / 2, y - size / 2, size, size);
    }
    pen.globalAlpha = 1;
    const path = part.path.map((p) => view.to(flat(p, side)));
    const ink = css("--ink");
    for (const [colour, width] of [[css("--paper"), 4.5], [css("--second"), 2.2]]) {
      pen.strokeStyle = colour;
      pen.lineWidth = width * ratio;
      pen.lineJoin = "round";
      pen.beginPath();
      path.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
      pen.stroke();
    }
    const dot = (i, radius, fill, edge) => {
      pen.beginPath();
      pen.arc(path[i][0], path[i][1], radius * ratio, 0, 2 * Math.PI);
      pen.fillStyle = fill;
      pen.fill();
      if (edge) { pen.strokeStyle = edge; pen.lineWidth = 1.6 * ratio; pen.stroke(); }
    };
    if (path.length <= 250) path.forEach((_, i) => dot(i, 2.4, css("--second")));
    part.loose.forEach((i) => dot(i, 4, css("--bad"), css("--card")));
    if (path.length) {
      dot(0, 5, "#ffffff", "#111111");
      if (path.length > 1) dot(path.length - 1, 5, "#111111", "#ffffff");
    }
    const picked = part.views.indexOf(state.picked);
    if (picked >= 0) dot(picked, 7, css("--accent"), css("--card"));
    if (part.moving) move(pen, part, (place) => view.to(flat(place, side)), ratio);
    bar(pen, canvas, view.per, ratio, ink);
  }

  // where a body is at a time, as a number among its places; -1 when it was not seen
  const place = (moving, k, now) => {
    const [first, last] = moving.seen[k];
    if (now < first || now > last) return -1;
    return last > first ? ((now - first) / (last - first)) * (moving.counts[k] - 1) : 0;
  };
  const between = (get, along) => {
    const k = Math.floor(along), s = along - k, a = get(k), b = s ? get(k + 1) : a;
    return a.map((v, c) => v + s * (b[c] - v));
  };
  const hues = ["#0ca678", "#ae3ec9", "#e03131", "#e8a200", "#1098ad", "#74a90f", "#d6336c"];

  function move(pen, part, to, ratio) {
    const moving = part.moving, now = state.now, few = moving.counts.length <= 60, span = moving.span[1] - moving.span[0];
    const line = (k, from, until, alpha) => {
      const get = (j) => moving.at(moving.starts[k] + j);
      pen.globalAlpha = alpha;
      pen.beginPath();
      pen.moveTo(...to(between(get, from)));
      for (let j = Math.floor(from) + 1; j < until; j++) pen.lineTo(...to(get(j)));
      pen.lineTo(...to(between(get, until)));
      pen.stroke();
    };
    pen.lineWidth = 1.4 * ratio;
    moving.counts.forEach((count, k) => {
      pen.strokeStyle = hues[moving.colours[k] % hues.length];
      // of many bodies only the last moments are drawn
      const [first, last] = moving.seen[k], since = Math.max(first, few ? first : now - 0.08 * span);
      if (few) line(k, 0, count - 1, 0.22);
      if (now > since && since <= last) line(k, place(moving, k, since), place(moving, k, Math.min(now, last)), 0.7);
    });
    pen.globalAlpha = 1;
    pen.lineWidth = ratio;
    pen.strokeStyle = css("--card");
    moving.counts.forEach((_, k) => {
      const along = place(moving, k, now);
      if (along >= 0) mark(pen, to(between((j) => moving.at(moving.starts[k] + j), along)), (few ? 4 : 2.6) * ratio,
        hues[moving.colours[k] % hues.length]);
    });
    if (!moving.views) return;
    const next = moving.views.findIndex((t) => t >= now), i = next < 0 ? moving.views.length - 1 : next;
    const [a, b] = [moving.views[Math.max(0, i - 1)], moving.views[i]];
    const share = b > a ? Math.min(1, (now - a) / (b - a)) : 1;
    mark(pen, to(between((j) => part.path[Math.min(j, part.path.length - 1)], Math.max(0, i - 1 + share))), 7 * ratio, css("--accent"));
  }
  const mark = (pen, [x, y], radius, fill) => {
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
    pen.fillStyle = fill;
    pen.fill();
    pen.stroke();
  };

  function bar(pen, canvas, per, ratio, ink) {
    const rough = (0.22 * canvas.width) / per, ten = 10 ** Math.floor(Math.log10(rough));
    const length = ten * (rough / ten >= 5 ? 5 : rough / ten >= 2 ? 2 : 1);
    const x = 14 * ratio, y = canvas.height - 14 * ratio, end = x + length * per;
    pen.strokeStyle = pen.fillStyle = ink;
    pen.lineWidth = 1.5 * ratio;
    pen.beginPath();
    pen.moveTo(x, y - 4 * ratio); pen.lineTo(x, y); pen.lineTo(end, y); pen.lineTo(end, y - 4 * ratio);
    pen.stroke();
    pen.font = `${12 * ratio}px system-ui, sans-serif`;
    pen.fillText(`${Number(length.toPrecision(2))}${data.unit ? ` ${data.unit}` : ""}`, x + 5 * ratio, y - 6 * ratio);
  }

  // the clock
  const [time, play] = ["time", "play"].map((id) => document.getElementById(id));
  const at = (share) => {
    const moving = parts[state.part].moving;
    if (!time || !moving) return;
    state.now = moving.span[0] + share * (moving.span[1] - moving.span[0]);
    time.value = Math.round(1000 * share);
    const seen = moving.counts.filter((_, k) => place(moving, k, state.now) >= 0).length;
    document.getElementById("now").textContent = `${state.now.toFixed(2)} s, ${seen} seen`;
    redraw();
  };
  const begin = () => {
    if (!time) return;
    const moving = parts[state.part].moving;
    document.getElementById("clock").hidden = !moving;
    document.getElementById("moving").textContent = !moving ? "" : "Blue: the camera at this time. Discs: bodies, one "
      + "colour each, with the way they came" + (moving.counts.length < moving.total
        ? `; ${moving.counts.length.toLocaleString("en")} of ${moving.total.toLocaleString("en")} drawn.` : ".");
    at(time.value / 1000);
  };
  // the whole takes twelve seconds
  let playing = 0, share = 0;
  const step = (clock) => {
    if (!playing) return;
    share = Math.min(1, share + (clock - playing) / 12000);
    playing = clock;
    at(share);
    if (share < 1) requestAnimationFrame(step); else run(false);
  };
  const run = (on) => {
    playing = on ? performance.now() : 0;
    play.textContent = on ? "Pause" : "Play";
    play.setAttribute("aria-pressed", on);
    if (!on) return;
    share = time.value >= 1000 ? 0 : time.value / 1000;
    requestAnimationFrame(step);
  };
  if (time) {
    time.addEventListener("input", () => { run(false); at(time.value / 1000); });
    play.addEventListener("click", () => run(!playing));
  }

  let asked = false;
  const redraw = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => { asked = false; canvases.forEach(draw); });
  };
  const zoom = (side, factor, about) => {
    const box = state.boxes[side], middle = about || [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2];
    state.boxes[side] = box.map((v, k) => middle[k % 2] + (v - middle[k % 2]) / factor);
    redraw();
  };
  const pick = (view) => {
    state.picked = view;
    document.querySelectorAll(".strip button").forEach((b) => b.setAttribute("aria-pressed", b.dataset.view == view));
    redraw();
  };

  canvases.forEach((canvas, side) => {
    const tip = canvas.parentElement.querySelector(".tip");
    let from = null;
    const nearest = (event) => {
      const box = canvas.getBoundingClientRect(), ratio = canvas.width / box.width, view = pixels(canvas, side);
      const at = [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
      let best = -1, least = 16 * ratio;
      parts[state.part].path.forEach((p, i) => {
        const [x, y] = view.to(flat(p, side)), off = Math.hypot(x - at[0], y - at[1]);
        if (off < least) { best = i; least = off; }
      });
      const plane = [(at[0] - view.x) / view.per, (view.y - at[1]) / view.per];
      return { best, at: at.map((v) => v / ratio), plane };
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.pointerType === "mouse") from = [event.clientX, event.clientY]; // a finger scrolls the page
    });
    window.addEventListener("pointerup", () => { from = null; });
    canvas.addEventListener("pointermove", (event) => {
      if (from) {
        const per = pixels(canvas, side).per / (canvas.width / canvas.getBoundingClientRect().width);
        const move = [(from[0] - event.clientX) / per, (event.clientY - from[1]) / per];
        state.boxes[side] = state.boxes[side].map((v, k) => v + move[k % 2]);
        from = [event.clientX, event.clientY];
        redraw();
        return;
      }
      const { best, at } = nearest(event), part = parts[state.part];
      tip.hidden = best < 0;
      if (best < 0) return;
      const view = part.views[best], thumb = thumbOf.get(view);
      tip.replaceChildren();
      if (thumb) { const img = new Image(); img.src = thumb.src; img.alt = ""; tip.append(img); }
      tip.append(`${part.names[best]}: ${part.counts[best]} points`);
      tip.style.left = `${Math.max(0, Math.min(at[0] + 14, canvas.clientWidth - 240))}px`;
      tip.style.top = `${at[1] + 14}px`;
    });
    canvas.addEventListener("pointerleave", () => { tip.hidden = true; });
    canvas.addEventListener("click", (event) => {
      const { best } = nearest(event);
      if (best >= 0) pick(parts[state.part].views[best]);
    });
    canvas.addEventListener("dblclick", (event) => zoom(side, 2, nearest(event).plane));
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return; // the wheel alone scrolls the page
      event.preventDefault();
      zoom(side, event.deltaY < 0 ? 1.2 : 1 / 1.2, nearest(event).plane);
    }, { passive: false });
  });
  document.querySelectorAll("[data-zoom]").forEach((button) => button.addEventListener("click", () => {
    const factor = Number(button.dataset.zoom);
    if (factor) canvases.forEach((_, side) => zoom(side, factor)); else { reset(); redraw(); }
  }));
  document.querySelectorAll("[data-colour]").forEach((button) => button.addEventListener("click", () => {
    state.colour = button.dataset.colour;
    document.querySelectorAll("[data-colour]").forEach((b) => b.setAttribute("aria-pressed", b === button));
    redraw();
  }));
  const choice = document.getElementById("part");
  if (choice) choice.addEventListener("change", () => { state.part = Number(choice.value); reset(); redraw(); });
  document.querySelectorAll(".strip button").forEach((button) => {
    button.addEventListener("click", () => pick(Number(button.dataset.view)));
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  new ResizeObserver(redraw).observe(canvases[0]);
  reset();
  redraw();
  document.documentElement.dataset.drawn = "yes";
})();
