export class Poles {
  constructor(page) { this.page = page; this.keys = {}; }
  async load() {}
  content() { return []; }
  legend() { return []; }
  status() { return ""; }
  draw() {}
  click() {}
  onKey() { return false; }
}
