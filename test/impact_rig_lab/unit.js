// Unit tests of the page's pure modules; test_units.py runs them in the browser of the other tests.
(async () => {
  const { hermite, Motion, Clock } = await import("/static/motion.js");
  const { clock, decibel, engineering, fixed, limits, line, steps, withUncertainty } = await import("/static/format.js");
  const { Knobs, patience, status } = await import("/static/store.js");
  const { decode, Kind } = await import("/static/frames.js");
  const { drawPhase, drawRig } = await import("/static/rigview.js");
  const results = [];
  const same = (found, expected) => {
    const [a, b] = [JSON.stringify(found), JSON.stringify(expected)];
    if (a !== b) throw new Error(`${a} is not ${b}`);
  };
  const near = (found, expected, within = 1e-9) => {
    if (!(Math.abs(found - expected) <= within)) throw new Error(`${found} is not ${expected} ± ${within}`);
  };
  const test = (name, run) => {
    try { run(); results.push([name, ""]); } catch (error) { results.push([name, String(error)]); }
  };
  const table = (rows) => ({ rows: rows.length, columns: rows[0].length, values: new Float64Array(rows.flat()) });

  test("hermite pieces go through both ends and are exact for cubics", () => {
    const x = (t) => 2 - t + 3 * t * t - 0.5 * t ** 3, v = (t) => -1 + 6 * t - 1.5 * t * t;
    for (const t of [1, 1.3, 1.9, 2]) near(hermite(1, x(1), v(1), 2, x(2), v(2), t), x(t), 1e-12);
  });
  test("what is shown as zero has no sign", () => {
    same([fixed(-0.04, 1), fixed(-0.06, 1), fixed(-0.4, 0), fixed(0, 2)], ["0.0", "-0.1", "0", "0.00"]);
    same([clock(-0.04), clock(-0.06), clock(0)], ["0.0 s", "−0.1 s", "0.0 s"]);
  });
  test("the sphere turns at the wall, not between samples", () => {
    const motion = new Motion(), gap = 0.006; // structure at rest, sphere flies to the right wall and back
    motion.add("states", table([[0, 0, 0, 0, 0, 0, 1], [0.01, 0, 0, -0.0005, 0, 0, -0.5]]));
    motion.add("impacts", table([[0.003, 1, 1, 0.5, 40]]));
    near(motion.at(0.003, gap).sphere, 0.003, 1e-9);
    near(motion.at(0.0015, gap).sphere, 0.0015, 1e-9);
    near(motion.at(0.005, gap).sphere, 0.002, 1e-4);
    same(motion.flash(0.004, 1, 0.1).force, 40);
    same(motion.flash(0.004, -1, 0.1), null);
    same(motion.at(0.02, gap), null);
  });
  test("motion is kept for a while, and restarts when time jumps back", () => {
    const motion = new Motion(1);
    for (let i = 0; i < 300; i++) motion.add("states", table([[i / 100, 0, 0, 0, 0, 0, 0]]));
    near(motion.newest - motion.oldest, 1, 0.011);
    motion.add("states", table([[0, 0, 0, 0, 0, 0, 0]]));
    same(motion.states.length, 0);
    motion.add("states", table([[5, 0, 0, 0, 0, 0, 0]]));
    motion.add("states", table([[0, 0, 0, 0, 0, 0, 0], [0.01, 0, 0, 0, 0, 0, 0], [0.02, 0, 0, 0, 0, 0, 0]]));
    same(motion.states.length, 2); // what follows in one table is motion of the new record
  });
  test("impacts are kept for the longest window of the scope, longer than the motion", () => {
    const motion = new Motion();
    for (let i = 0; i <= 1200; i++) {
      motion.add("states", table([[i / 100, 0, 0, 0, 0, 0, 0]]));
      if (i % 10 === 0) motion.add("impacts", table([[i / 100, 1, 1, 0.5, 40]]));
    }
    near(motion.newest - motion.oldest, 6, 0.011);
    if (motion.newest - motion.impacts[0][0] < 10) throw new Error(`only ${motion.newest - motion.impacts[0][0]} s of impacts`);
  });
  test("without a sphere there are no barriers of some gap", () => {
    const drawn = (draw, present) => {
      const canvas = document.createElement("canvas"), g = canvas.getContext("2d");
      Object.assign(canvas.style, { position: "fixed", width: "300px", height: "200px" });
      document.body.append(canvas);
      let count = 0;
      g.fillRect = g.setLineDash = () => { count++; };
      const moveTo = g.moveTo.bind(g);
      g.moveTo = (x, y) => { count++; moveTo(x, y); };
      draw(canvas, { gap: 0.004, present });
      canvas.remove();
      return count;
    };
    const rig = (canvas, knobs) => drawRig(canvas, { base: 0, structure: 0, sphere: 0 }, knobs, () => null);
    const plane = (canvas, knobs) => drawPhase(canvas, new Motion(), 0, knobs, 0.6);
    for (const draw of [rig, plane]) same(drawn(draw, true) - drawn(draw, false), 2);
  });
  test("the clock runs steadily behind the data and catches up after a jump", () => {
    const pace = new Clock(0.12);
    let newest = 10, before = pace.advance(0.016, newest, 1);
    for (let i = 0; i < 200; i++) {
      if (i % 3 === 0) newest += 0.048;
      const t = pace.advance(0.016, newest, 1);
      if (t < before || t > newest) throw new Error("it went back, or ahead of the data");
      before = t;
    }
    near(newest - before, 0.12, 0.06);
    near(pace.advance(0.016, 100, 1), 99.88, 1e-9);
  });
  test("numbers for people", () => {
    same([engineering(0.00585, "m"), engineering(0, "A"), engineering(-1.5e-5, "m"), engineering(NaN, "m")], ["5.85 mm", "0 A", "-15.0 µm", "–"]);
    same([clock(12.34), clock(245.2), clock(119.96), clock(3723), clock(3599.99), clock(-3), clock(NaN)], ["12.3 s", "4:05.2", "2:00.0", "1:02:03", "1:00:00", "−3.0 s", "–"]);
    same(withUncertainty(63.5465, 0.1597), ["63.55", "± 0.32"]);
    same([withUncertainty(2, 0.0498), withUncertainty(0.0641, 3.2e-8)], [["2.00", "± 0.10"], ["0.064100000", "± 0.000000064"]]);
    same([withUncertainty(110.42, 6), withUncertainty(12345.6, 339)], [["110", "± 12"], ["12350", "± 680"]]);
    same([withUncertainty(110.3, NaN), withUncertainty(NaN, 1)], [["110.3", ""], ["–", ""]]);
    near(decibel(0.1), -20);
    same(steps(8.5, 9.7, 4), [8.5, 8.9, 9.3, 9.7]);
    same(steps(9.1, 12, 1), [9.1]);
  });
  test("an axis holds still until something leaves it, or most of it is empty", () => {
    const first = limits(null, -1, 1);
    same(limits(first, -0.9, 0.9), first);
    if (limits(first, -2, 2)[1] < 2) throw new Error("it does not grow");
    if (limits(first, -0.1, 0.1)[1] > 0.5) throw new Error("it does not shrink");
    same(limits(first, NaN, NaN), first);
  });
  test("a line goes through minimum and maximum of every column, and is broken where nothing is known", () => {
    const [x, y] = line(new Float32Array([1, 0, NaN]), new Float32Array([2, 1.5, NaN]), 0.1);
    same([x.length, y], [6, [1, 2, 1.5, 0, null, null]]);
    near(x[1], 0.075);
  });
  test("a knob waits for the answer to its own request", () => {
    const knobs = new Knobs();
    knobs.ask("gap", 1);
    same([knobs.state("gap"), knobs.follows("gap")], ["pending", false]);
    knobs.ask("gap", 2);
    knobs.answer("gap", 1, false, "old");
    same(knobs.state("gap"), "pending");
    knobs.answer("gap", 2, false, "too wide");
    same([knobs.state("gap"), knobs.words("gap"), knobs.follows("gap")], ["refused", "too wide", true]);
    knobs.ask("gap", 3);
    knobs.lose();
    same(knobs.state("gap"), "refused");
  });
  test("nothing stale is shown as live", () => {
    same([status(false, { word: "driving" }).word, status(false, undefined).stale], ["offline", true]);
    same([status(true, { word: "dead" }).stale, status(true, { word: "driving" }).stale], [true, false]);
    same([status(true, { word: "no peer", waits: true }).stale, status(true, { word: "no peer", waits: false }).stale], [true, false]);
    same(new Set(["at rest", "driving", "settling", "tripped"].map((word) => status(true, { word }).lamp)).size, 4);
    if (!(patience(0) < 1 && patience(20) === 5)) throw new Error("it waits too long, or not long enough");
  });
  test("frames are decoded", () => {
    const frame = new ArrayBuffer(8 + 40 + 2 * 4 * 2 + 2), view = new DataView(frame);
    view.setUint8(0, Kind.TRACE);
    view.setUint32(4, 9, true);
    [1.5, 0.01, NaN, 3].forEach((value, i) => view.setFloat64(8 + 8 * i, value, true));
    view.setUint32(40, 1, true);
    view.setUint32(44, 2, true);
    [1, 2, 3, 4].forEach((value, i) => view.setFloat32(48 + 4 * i, value, true));
    view.setUint8(65, 4);
    const { number, content } = decode(frame);
    same([number, content.begin, [...content.low[0]], [...content.high[0]], [...content.status]], [9, 1.5, [1, 2], [3, 4], [0, 4]]);
  });
  return results;
})()
