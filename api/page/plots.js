// The two live plots: force with its ceiling, and depth with the depth that the lock permits.
// The page loads uPlot before this module: its minified form is no module.
const { uPlot } = window;

const WINDOW_S = 20;
const INK = "#14202b";
const GRID = { stroke: "#dde3e8", width: 1 };

export class LivePlots {
  constructor(forceFigure, depthFigure) {
    this.frames = [];
    this.ceiling = null;
    this.force = this.#plot(forceFigure, [
      { label: "|F|, peak", stroke: "#0072b2", width: 2 },
      { label: "Fz", stroke: "#e69f00", width: 2, dash: [8, 3] },
      { label: "ceiling", stroke: "#b84300", width: 2, dash: [2, 3] },
    ], { range: (_plot, low, high) => [Math.min(-5, low ?? 0), Math.max(1.1 * (this.ceiling ?? 10), high ?? 0)] });
    this.depth = this.#plot(depthFigure, [
      { label: "depth", stroke: "#0072b2", width: 2 },
      { label: "limit of the lock", stroke: "#b84300", width: 2, dash: [6, 3], spanGaps: false },
    ], { dir: -1, range: (_plot, low, high) => [Math.min(-5, low ?? 0), Math.max(5, high ?? 0)] });
    this.sizes = new ResizeObserver(() => this.#resize());
    this.sizes.observe(forceFigure);
    this.sizes.observe(depthFigure);
  }

  add(frame) {
    const last = this.frames.at(-1);
    if (last && (frame.t <= last.t || frame.t - last.t > WINDOW_S)) this.frames.length = 0; // the arm's clock restarted
    this.frames.push({ ...frame, ceiling: this.ceiling }); // the one in force when it was measured
    while (this.frames[0].t < frame.t - WINDOW_S) this.frames.shift();
    this.dirty = true;
  }

  draw() {
    if (!this.dirty) return;
    this.dirty = false;
    const now = this.frames.at(-1).t;
    const t = this.frames.map((frame) => frame.t - now);
    const mm = (metres) => (metres === null ? null : 1e3 * metres);
    this.force.setData([
      t,
      this.frames.map((frame) => frame.force_peak_n),
      this.frames.map((frame) => frame.force_n[2]),
      this.frames.map((frame) => frame.ceiling),
    ]);
    this.depth.setData([
      t,
      this.frames.map((frame) => mm(frame.depth_m)),
      this.frames.map((frame) =>
        frame.depth_m === null || frame.z_lock_m === null ? null : mm(frame.depth_m + frame.tcp_z_m - frame.z_lock_m)),
    ]);
  }

  #plot(figure, series, y) {
    const axis = { stroke: INK, grid: GRID, ticks: GRID, font: "12px system-ui", size: 42 };
    return new uPlot({
      width: figure.clientWidth - 18,
      height: 120,
      series: [{ label: "s" }, ...series.map((line) => ({ ...line, points: { show: false } }))],
      scales: { x: { time: false, range: [-WINDOW_S, 0] }, y },
      axes: [{ ...axis, size: 26, values: (_plot, ticks) => ticks.map((tick) => `${tick} s`) }, axis],
      cursor: { show: false },
      legend: { show: true, live: false },
      padding: [6, 8, 0, 0],
    }, [[], ...series.map(() => [])], figure);
  }

  #resize() {
    for (const plot of [this.force, this.depth]) {
      const figure = plot.root.parentElement;
      plot.setSize({ width: figure.clientWidth - 18, height: Math.max(90, figure.clientHeight - 30) });
    }
  }
}
