// A document that can be undone and redone, and that survives a reload of the page.

const MOST_STEPS = 200;

export class History {
  // key: where it is kept; saved: the document as the server has it.
  constructor(key, saved) {
    this.key = `roadsight-draft-${key}`;
    this.listeners = new Set();
    this.reset(saved);
  }

  // Start from what the server has; takes up unsaved work if it began from the same.
  reset(saved) {
    this.saved = JSON.stringify(saved);
    this.done = [this.saved];
    this.at = 0;
    this.restored = false;
    const draft = this.kept();
    if (draft && draft.now !== this.saved) {
      this.conflict = draft.saved !== this.saved;
      this.restored = true;
      this.done.push(draft.now);
      this.at = 1;
    }
    this.now = JSON.parse(this.done[this.at]);
  }

  kept() {
    try {
      const draft = JSON.parse(localStorage.getItem(this.key));
      JSON.parse(draft.now);
      return draft;
    } catch {
      return null;
    }
  }

  // Change the document; `alike` joins quick changes of the same kind into one step.
  change(edit, alike = null) {
    edit(this.now);
    const text = JSON.stringify(this.now);
    if (text === this.done[this.at]) return;
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

  get dirty() { return this.done[this.at] !== this.saved; }
  get canUndo() { return this.at > 0; }
  get canRedo() { return this.at < this.done.length - 1; }

  // The server has what is here now.
  wasSaved(saved = this.now) {
    this.saved = JSON.stringify(saved);
    this.now = JSON.parse(this.saved);
    this.done[this.at] = this.saved;
    this.alike = null;
    this.keep();
    this.tell();
  }

  keep() {
    if (!this.dirty) localStorage.removeItem(this.key);
    else localStorage.setItem(this.key, JSON.stringify({ saved: this.saved, now: this.done[this.at] }));
  }

  tell() { for (const listener of this.listeners) listener(); }
}
