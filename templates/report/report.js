// Plays the flights on a canvas. Angles are in radian, time in second, lengths in metre.
(function () {
  "use strict";

  // Paper is light and cannot be unfolded.
  const root = document.documentElement;
  const unfolded = [];
  let redraw = function () {};
  window.addEventListener("beforeprint", function () {
    document.querySelectorAll("details.long:not([open])").forEach(function (details) {
      details.open = true;
      unfolded.push(details);
    });
    root.classList.add("paper");
    redraw();
  });
  window.addEventListener("afterprint", function () {
    unfolded.splice(0).forEach(function (details) { details.open = false; });
    root.classList.remove("paper");
    redraw();
  });

  const source = document.getElementById("flight-data");
  if (!source) { return; }
  const flights = JSON.parse(source.textContent).flights;
  const stage = document.getElementById("stage");
  const pen = stage.getContext("2d");
  const play = document.getElementById("play");
  const scrub = document.getElementById("scrub");
  const clock = document.getElementById("clock");
  const speed = document.getElementById("speed");
  const view = document.getElementById("view");
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  const traceSeconds = 1.2;
  const flightColours = 4;
  const arcPart = 0.3;
  const labelHeight = 16;
  const duration = Math.max(...flights.map(lengthOf));
  const peak = Math.max(1e-9, ...flights.map(function (flight) {
    return flight.torque.reduce(function (most, value) { return Math.max(most, Math.abs(value)); }, 0);
  }));
  const extent = extentOf();
  const cursors = timeCursors();
  let time = 0;
  let playing = false;
  let before = null;

  function lengthOf(flight) { return (flight.torque.length - 1) * flight.frame; }

  function sample(values, frame, at) {
    const place = Math.min(Math.max(at / frame, 0), values.length - 1);
    const index = Math.floor(place);
    const next = Math.min(index + 1, values.length - 1);
    return values[index] + (place - index) * (values[next] - values[index]);
  }

  function anglesAt(flight, at) {
    return flight.angles.map(function (values) { return sample(values, flight.frame, at); });
  }

  // The elbow and the tip, from the shoulder; the second angle is relative to the first link.
  function jointsOf(links, angles) {
    const elbow = [links[0] * Math.cos(angles[0]), links[0] * Math.sin(angles[0])];
    const sum = angles[0] + angles[1];
    return [elbow, [elbow[0] + links[1] * Math.cos(sum), elbow[1] + links[1] * Math.sin(sum)]];
  }

  // What all flights sweep, around the shoulder, with room for the torque's arc.
  function extentOf() {
    const found = { side: 0, low: 0, high: 0 };
    flights.forEach(function (flight) {
      const arc = 1.4 * arcPart * flight.links[0];
      const points = [[arc, arc], [-arc, -arc], ...jointsOf(flight.links, flight.setpoint)];
      flight.torque.forEach(function (_, index) {
        points.push(...jointsOf(flight.links, flight.angles.map(function (values) { return values[index]; })));
      });
      points.forEach(function (point) {
        found.side = Math.max(found.side, Math.abs(point[0]));
        found.low = Math.min(found.low, point[1]);
        found.high = Math.max(found.high, point[1]);
      });
    });
    return found;
  }

  function colour(name) {
    return getComputedStyle(root).getPropertyValue("--" + name).trim();
  }

  function shown() {
    const all = flights.map(function (_, index) { return index; });
    return !view || view.value === "all" ? all : [Number(view.value)];
  }

  function draw() {
    const which = shown();
    const width = stage.parentElement.clientWidth;
    const columns = Math.min(which.length, Math.max(2, Math.floor(width / 260)));
    const rows = Math.ceil(which.length / columns);
    pen.font = labelFont();
    const labels = which.map(function (index) { return wrapped(flights[index].label, width / columns - 24); });
    const top = 28 + labelHeight * Math.max(...labels.map(function (lines) { return lines.length; }));
    const height = Math.round(Math.min(440, Math.max(270, 0.9 * width / columns)));
    const ratio = window.devicePixelRatio || 1;
    stage.width = Math.round(width * ratio);
    stage.height = Math.round(height * rows * ratio);
    stage.style.height = height * rows + "px";
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    which.forEach(function (index, place) {
      const panel = { width: width / columns, height: height, top: top, label: labels[place] };
      pen.save();
      pen.translate((place % columns) * panel.width, Math.floor(place / columns) * height);
      pen.beginPath();
      pen.rect(0, 0, panel.width, height);
      pen.clip();
      drawPanel(flights[index], "flight-" + (index % flightColours + 1), panel);
      pen.restore();
    });
    clock.value = time.toFixed(2) + " s";
    scrub.value = time;
    cursors.forEach(function (move) { move(time); });
  }

  function drawPanel(flight, name, panel) {
    const angles = anglesAt(flight, time);
    const torque = sample(flight.torque, flight.frame, time);
    const small = panel.width < 240;
    const top = panel.top;
    const bottom = small ? 58 : 44;
    const scale = Math.min((panel.width - 24) / (2 * extent.side),
      (panel.height - top - bottom) / (extent.high - extent.low));
    const spare = panel.height - top - bottom - scale * (extent.high - extent.low);
    const centre = [panel.width / 2, top + spare / 2 + scale * extent.high];
    const at = function (point) {
      return [centre[0] + scale * point[0], centre[1] - scale * point[1]];
    };
    drawMount(centre, panel.width);
    drawTrace(flight, name, at);
    drawLinks(jointsOf(flight.links, flight.setpoint).map(at), centre, "muted", true);
    drawTorque(torque, centre, arcPart * flight.links[0] * scale);
    drawLinks(jointsOf(flight.links, angles).map(at), centre, name, false);
    drawWords(flight, angles, torque, panel, name, small);
  }

  function drawMount(centre, width) {
    pen.strokeStyle = colour("grid");
    pen.lineWidth = 1;
    line([[12, centre[1]], [width - 12, centre[1]]]);
  }

  function line(points) {
    pen.beginPath();
    points.forEach(function (point, index) {
      if (index) { pen.lineTo(point[0], point[1]); } else { pen.moveTo(point[0], point[1]); }
    });
    pen.stroke();
  }

  function drawTrace(flight, name, at) {
    const steps = Math.ceil(Math.min(traceSeconds, time) / flight.frame);
    const tip = function (back) {
      return at(jointsOf(flight.links, anglesAt(flight, time - back * flight.frame))[1]);
    };
    pen.strokeStyle = colour(name);
    pen.lineWidth = 2;
    for (let back = steps; back > 0; back -= 1) {
      pen.globalAlpha = 0.55 * (1 - back / (traceSeconds / flight.frame + 1));
      line([tip(back), tip(back - 1)]);
    }
    pen.globalAlpha = 1;
  }

  function drawLinks(joints, centre, name, ghost) {
    pen.lineCap = "round";
    pen.lineJoin = "round";
    pen.strokeStyle = colour(name);
    pen.globalAlpha = ghost ? 0.28 : 1;
    pen.lineWidth = ghost ? 12 : 7;
    line([centre, joints[0], joints[1]]);
    pen.globalAlpha = 1;
    if (ghost) { return; }
    dot(centre, 7, "ink");
    dot(joints[0], 5, "ink");
    dot(joints[1], 5, name);
  }

  function dot(point, radius, name) {
    pen.beginPath();
    pen.arc(point[0], point[1], radius, 0, 2 * Math.PI);
    pen.fillStyle = colour("card");
    pen.fill();
    pen.strokeStyle = colour(name);
    pen.lineWidth = 2.5;
    pen.stroke();
  }

  // The torque as an arc from straight down, counter-clockwise where positive.
  function drawTorque(torque, centre, radius) {
    const turn = 1.5 * Math.PI * torque / peak;
    const end = Math.PI / 2 - turn;
    pen.strokeStyle = pen.fillStyle = colour("ink");
    pen.globalAlpha = 0.75;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.arc(centre[0], centre[1], radius, Math.PI / 2, end, turn > 0);
    pen.stroke();
    if (Math.abs(turn) * radius > 4) {
      const forward = end - Math.sign(turn) * Math.PI / 2;
      const head = [centre[0] + radius * Math.cos(end), centre[1] + radius * Math.sin(end)];
      const corner = function (length, angle) {
        pen.lineTo(head[0] + length * Math.cos(angle), head[1] + length * Math.sin(angle));
      };
      pen.beginPath();
      corner(4, forward);
      corner(7, forward + Math.PI - 0.6);
      corner(7, forward + Math.PI + 0.6);
      pen.fill();
    }
    pen.globalAlpha = 1;
  }

  function labelFont() { return "600 13px " + colour("sans"); }

  function drawWords(flight, angles, torque, panel, name, small) {
    pen.textAlign = "left";
    pen.fillStyle = colour(name);
    pen.font = labelFont();
    panel.label.forEach(function (words, row) { pen.fillText(words, 12, 22 + labelHeight * row); });
    pen.fillStyle = colour("ink");
    pen.font = "13px " + colour("sans");
    const signed = function (value) { return (value < 0 ? "−" : "") + Math.abs(value).toFixed(2); };
    const joints = flight.names.map(function (symbol, k) { return symbol + " " + signed(angles[k]); });
    pen.fillText("τ " + signed(torque) + " " + flight.unit, 12, panel.height - (small ? 30 : 12));
    pen.textAlign = small ? "left" : "right";
    pen.fillText(joints.join("  ") + " rad", small ? 12 : panel.width - 12, panel.height - 12);
  }

  // `text` in lines of at most `width`, in the current font.
  function wrapped(text, width) {
    const lines = [""];
    text.split(" ").forEach(function (word) {
      const longer = (lines[lines.length - 1] + " " + word).trim();
      if (pen.measureText(longer).width <= width) {
        lines[lines.length - 1] = longer;
      } else {
        lines.push(word);
      }
    });
    return lines;
  }

  // One function a figure that puts its vertical line at a time.
  function timeCursors() {
    return Array.from(document.querySelectorAll("svg[data-axis]"), function (svg) {
      const [left, right, top, bottom, start, end] = svg.dataset.axis.split(" ").map(Number);
      const cursor = document.createElementNS(svg.namespaceURI, "line");
      cursor.setAttribute("class", "cursor");
      cursor.setAttribute("y1", top);
      cursor.setAttribute("y2", bottom);
      svg.appendChild(cursor);
      svg.classList.add("seekable");
      svg.addEventListener("click", function (event) {
        const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
        pause();
        seek(start + (point.x - left) / (right - left) * (end - start));
      });
      return function (at) {
        const x = left + (at - start) / (end - start) * (right - left);
        cursor.setAttribute("x1", x);
        cursor.setAttribute("x2", x);
        cursor.style.visibility = at > start && at <= end ? "visible" : "hidden";
      };
    });
  }

  function seek(at) {
    time = Math.min(Math.max(at, 0), duration);
    draw();
  }

  function start() {
    if (time >= duration) { time = 0; }
    playing = true;
    before = null;
    play.textContent = "❚❚";
    play.setAttribute("aria-label", "Pause");
    window.requestAnimationFrame(tick);
  }

  function pause() {
    playing = false;
    play.textContent = "▶";
    play.setAttribute("aria-label", "Play");
  }

  function toggle() { if (playing) { pause(); } else { start(); } }

  function tick(now) {
    if (!playing) { return; }
    const passed = before === null ? 0 : Math.min(now - before, 100) / 1000;
    before = now;
    seek(time + passed * Number(speed.value));
    if (time >= duration) { pause(); } else { window.requestAnimationFrame(tick); }
  }

  function seekToHash() {
    const found = /^#t=(\d+(\.\d+)?)$/.exec(window.location.hash);
    if (found) {
      pause();
      seek(Number(found[1]));
    }
    return found !== null;
  }

  function visible() {
    const box = stage.getBoundingClientRect();
    return box.bottom > 0 && box.top < window.innerHeight;
  }

  redraw = draw;
  scrub.max = duration;
  play.addEventListener("click", toggle);
  scrub.addEventListener("input", function () { pause(); seek(Number(scrub.value)); });
  if (view) { view.addEventListener("change", draw); }
  document.addEventListener("keydown", function (event) {
    const own = /^(BUTTON|SELECT|SUMMARY|A|TEXTAREA)$/.test(event.target.tagName);
    if (event.code !== "Space" || own || !visible()) { return; }
    event.preventDefault();
    toggle();
  });
  window.addEventListener("hashchange", seekToHash);
  window.addEventListener("resize", draw);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
  if (!seekToHash() && !still) {
    const watch = new IntersectionObserver(function (entries) {
      if (entries.some(function (entry) { return entry.isIntersecting; })) {
        watch.disconnect();
        if (time === 0) { start(); }
      }
    }, { threshold: 0.5 });
    watch.observe(stage);
  }
}());
