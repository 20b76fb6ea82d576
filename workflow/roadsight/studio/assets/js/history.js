// A document that can be undone and redone, and that survives a reload of the page.

const MOST_STEPS = 200;

const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

export class History {
  // key: where it is kept, within the project; saved: the document as the server has it.
  constructor(key, saved) {
    this.key = `roadsight-draft-${window.studio.project.id}-${key}`;
    this.listeners = new Set();
    this.reset(saved);
  }

  // Start from what the server has, and take up unsaved work: each part of the document that it
  // had changed. A conflict is a part that has changed on both sides.
  reset(saved) {
    this.saved = JSON.stringify(saved);
    this.done = [this.saved];
    this.at = 0;
    this.restored = this.conflict = false;
    const { before, now } = this.kept() ?? { before: saved, now: saved };
    const changed = Object.keys(saved).filter((part) => part in now && !same(now[part], before[part]) && !same(now[part], saved[part]));
    if (changed.length) {
      this.conflict = changed.some((part) => !same(before[part], saved[part]));
      this.restored = true;
      this.done.push(JSON.stringify({ ...saved, ...Object.fromEntries(changed.map((part) => [part, now[part]])) }));
      this.at = 1;
    }
    this.now = JSON.parse(this.text);
  }

  kept() {
    try {
      const draft = JSON.parse(localStorage.getItem(this.key));
      return { before: JSON.parse(draft.saved), now: JSON.parse(draft.now) };
    } catch {
      return null;
    }
  }

  // Change the document; `alike` joins quick changes of the same kind into one step.
  change(edit, alike = null) {
    edit(this.now);
    const text = JSON.stringify(this.now);
    if (text === this.text) return;
    if (alike !== null && alike === this.alike && this.at > 0 && this.at === this.done.length - 1) this.done[this.at] = text;
    else {
      this.done.splice(this.at + 1, Infinity, text);
      if (this.done.length > MOST_STEPS) this.done.shift();
      this.at = this.done.length - 1;
    }
    this.alike = alike;
    this.keep();
    this.tell();
  }

  step(by) {
    const to = this.at + by;
    if (to < 0 || to >= this.done.length) return false;
    this.at = to;
    this.alike = null;
    this.now = JSON.parse(this.done[to]);
    this.keep();
    this.tell();
    return true;
  }

  get text() { return this.done[this.at]; }
  get dirty() { return this.text !== this.saved; }
  get canUndo() { return this.at > 0; }
  get canRedo() { return this.at < this.done.length - 1; }

  // The server has made `saved` of `sent`, the text of then. What was changed meanwhile stays unsaved.
  wasSaved(saved, sent) {
    this.saved = JSON.stringify(saved);
    if (this.text === sent) {
      this.now = JSON.parse(this.saved);
      this.done[this.at] = this.saved;
    }
    this.alike = null;
    this.keep();
    this.tell();
  }

  keep() {
    if (!this.dirty) localStorage.removeItem(this.key);
    else localStorage.setItem(this.key, JSON.stringify({ saved: this.saved, now: this.text }));
  }

  tell() { for (const listener of this.listeners) listener(); }
}
