// One site: its state (plan and sensor shown) and everything that follows it.

class Site {
  constructor(section, tooltip) {
    this.section = section;
    this.content = readSite(JSON.parse(this.find(".site-data").textContent));
    this.sensor = null;
    this.targetsBy = "sensors";
    this.plan = this.content.plans.find((plan) => plan.name === this.find(".planbar input:checked")?.value) ?? null;
    this.map = new MapView(this.find(".map"), this.content, this, tooltip);
    this.scene = new SceneView(this.find(".scene3d"), this.content, this);
    this.listen();
    this.watchScene();
    this.showPlan();
  }

  find(selector) {
    return this.section.querySelector(selector);
  }

  all(selector) {
    return [...this.section.querySelectorAll(selector)];
  }

  choosePlan(name) {
    this.plan = this.content.plans.find((plan) => plan.name === name);
    this.sensor = null;
    this.show(null);
    for (const input of this.all(".planbar input")) input.checked = input.value === name;
    this.showPlan();
    this.draw();
  }

  // Chosen in the table, it may lie outside the map's view.
  chooseSensor(number, reveals = false) {
    this.sensor = number;
    this.show(null);
    if (number !== null && reveals) this.map.reveal(this.plan.sensors[number], this.map.fitted);
    this.showSensor();
    this.draw();
  }

  // Mark a line or a place of a table's row on the map; the same row again takes the mark away.
  show(button, xy = null) {
    const again = button?.getAttribute("aria-pressed") === "true";
    this.map.marked = again ? null : xy;
    for (const other of this.all("[data-show-place], [data-show-edge]")) {
      other.setAttribute("aria-pressed", other === button && !again);
    }
    if (this.map.marked) {
      this.map.revealMarked();
      this.map.stage.scrollIntoView({ block: "center" });
    }
    this.map.draw();
  }

  draw() {
    this.map.draw();
    this.scene.draw();
  }

  showPlan() {
    const name = this.plan?.name;
    for (const part of this.all("[data-for-plan]")) part.hidden = part.dataset.forPlan !== name;
    for (const row of this.all("[data-plan-row]")) mark(row, row.dataset.planRow === name);
    this.labelTargets();
    this.showSensor();
  }

  showSensor() {
    for (const row of this.all("[data-sensor-row]")) mark(row, Number(row.dataset.sensorRow) === this.sensor);
    for (const button of this.all("[data-choose-sensor]")) {
      button.setAttribute("aria-pressed", Number(button.dataset.chooseSensor) === this.sensor);
    }
    const note = this.find("[data-selection]");
    if (!note) return;
    note.replaceChildren();
    if (this.sensor === null) {
      note.textContent = "All sensors. Choose one to see what it sees.";
      return;
    }
    const all = document.createElement("button");
    all.textContent = "Show all sensors";
    all.addEventListener("click", () => this.chooseSensor(null));
    note.append(`${sensorText(this.plan.sensors[this.sensor])}.`, document.createElement("br"), all);
  }

  listen() {
    this.section.addEventListener("change", ({ target }) => {
      if (target.matches(".planbar input")) this.choosePlan(target.value);
      if (target.matches(".map-panel [data-layer]")) this.setLayer(this.map, target);
      if (target.matches(".scene-panel [data-layer]")) this.setLayer(this.scene, target);
      if (target.matches("[data-scene]")) this.setOption(target);
      if (target.matches("[data-targets-by]")) this.colourTargets(target.value);
      if (target.matches("[data-below]")) this.lay(target.value);
    });
    this.section.addEventListener("input", ({ target }) => {
      if (target.matches("[data-price]")) this.pricePlans();
    });
    this.section.addEventListener("click", ({ target }) => {
      const button = target.closest("button");
      const { choosePlan, chooseSensor, camera, showPlace, showEdge } = button?.dataset ?? {};
      if (choosePlan !== undefined) this.choosePlan(choosePlan);
      if (chooseSensor !== undefined) this.chooseSensor(this.sensor === Number(chooseSensor) ? null : Number(chooseSensor), true);
      if (showPlace !== undefined) this.show(button, showPlace.split(",").map(Number));
      if (showEdge !== undefined) this.show(button, this.content.edges[showEdge].xy);
      if (camera !== undefined) this.scene.setCamera(camera);
    });
    this.showRamp();
  }

  // Plans that know of traffic or of failures can colour targets by them; the choice holds for all that know it.
  colourTargets(by) {
    this.targetsBy = by;
    this.labelTargets();
    this.map.draw();
  }

  // A plan that does not know the choice is drawn by its sensors, and says so.
  labelTargets() {
    const shown = targetClasses(this.plan, this.targetsBy) ? this.targetsBy : "sensors";
    for (const choice of this.all("[data-targets-by]")) choice.value = shown;
    for (const legend of this.all("[data-targets-legend]")) legend.hidden = legend.dataset.targetsLegend !== shown;
  }

  // What the map lies on: relief, a picture, or nothing.
  lay(name) {
    this.map.below = name;
    this.map.draw();
  }

  // What each plan costs at the prices that a reader types; models without a price count as free.
  pricePlans() {
    const inputs = this.all("[data-price]");
    const prices = new Map(inputs.map((input) => [input.dataset.price, input.valueAsNumber || 0]));
    const asked = inputs.some((input) => input.value !== "");
    for (const cell of this.all("[data-plan-price]")) {
      cell.hidden = !asked;
      const plan = this.content.plans.find(({ name }) => name === cell.dataset.planPrice);
      if (plan) cell.textContent = formatNumber(plan.sensors.reduce((sum, { sensor }) => sum + prices.get(sensor), 0));
    }
  }

  setLayer(view, input) {
    view.layers[input.dataset.layer] = input.checked;
    view.draw();
  }

  setOption(input) {
    const numeric = input.dataset.scene === "size" || input.dataset.scene === "stretch";
    this.scene.options[input.dataset.scene] = numeric ? Number(input.value) : input.value;
    this.showRamp();
    this.scene.draw();
  }

  showRamp() {
    const ramp = this.find("[data-ramp]");
    const { colour } = this.scene.options;
    ramp.hidden = colour === "colour";
    const [low, high] = ramp.children;
    [low.textContent, high.textContent] = colour === "height" ? ["0 m", `${HIGHEST_SHADE_M} m and above`] : ["dark", "bright"];
    const ends = colour === "height" ? ["var(--cloud-low)", "var(--cloud-mid)", "var(--cloud-high)"] : ["#1a1f24", "#f2f4f6"];
    ramp.style.background = `linear-gradient(90deg, ${ends.join(", ")}) top / 100% 8px no-repeat`;
  }

  watchScene() {
    this.observer = new IntersectionObserver((entries) => {
      if (entries.some((entry) => entry.isIntersecting)) this.scene.open();
    }, { rootMargin: "300px" });
    this.resume();
  }

  pause() {
    this.observer.disconnect();
    this.scene.close();
  }

  resume() {
    this.observer.observe(this.scene.element);
  }

  recolour() {
    this.map.recolour();
    this.scene.draw();
  }

  print() {
    this.map.recolour();
    this.map.paintAll();
    this.scene.print();
  }
}

function mark(row, current) {
  if (current) row.setAttribute("aria-current", "true");
  else row.removeAttribute("aria-current");
}
