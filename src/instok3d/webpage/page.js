// The page: the picture, the list of objects, and what a person does with both.

class Page {
  constructor(scene) {
    this.scene = scene;
    const count = scene.about.objects.length + 1; // 0 is what belongs to no object
    this.state = {
      hidden: Array(count).fill(false),
      offsets: Array.from({ length: count }, () => [0, 0, 0]),
      colors: [[0.5, 0.5, 0.5], ...scene.about.objects.map((object) => rgb(object.color))],
      selected: new Set(),
      hovered: 0,
      colored: false,
    };
    this.canvas = document.querySelector("canvas");
    this.drawing = new Drawing(this.canvas, scene);
    this.viewpoint = new Viewpoint(scene.about.up);
    this.stand(0);
    this.rows = new ObjectList(this);
    this.fill();
    this.listen();
    new ResizeObserver(() => this.redraw()).observe(this.canvas);
    this.redraw();
  }

  fill() {
    const { about } = this.scene;
    document.querySelector("h1").textContent = about.name;
    document.querySelector("#about").textContent = about.lines.join("\n");
    const views = document.querySelector("#views");
    about.views.forEach((view, index) => {
      const button = document.createElement("button");
      button.title = `stand where ${view.file} was taken`;
      const picture = document.createElement("img");
      picture.src = view.photo;
      picture.alt = view.file;
      button.append(picture);
      button.addEventListener("click", () => {
        this.stand(index);
        this.redraw();
      });
      views.append(button);
    });
  }

  stand(index) {
    const views = this.scene.about.views;
    this.viewpoint.stand(views[Math.min(index, views.length - 1)], this.scene.about.distance);
  }

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.drawNow();
    });
  }

  drawNow() {
    const factor = this.fixedSize ? 1 : window.devicePixelRatio || 1;
    const [width, height] = this.fixedSize || [this.canvas.clientWidth, this.canvas.clientHeight];
    this.canvas.width = Math.max(1, Math.round(width * factor));
    this.canvas.height = Math.max(1, Math.round(height * factor));
    this.drawing.draw(this.viewpoint, this.state);
    this.rows.show(this.state);
    document.querySelector("#commands").textContent = this.commands().join("\n");
  }

  /** Index of the object at a place of the page, 0 for none. */
  objectAt(x, y) {
    const box = this.canvas.getBoundingClientRect();
    const factor = this.canvas.height / box.height;
    return pick(this.scene, this.state, this.viewpoint, (x - box.left) * factor, (y - box.top) * factor,
      this.canvas.width, this.canvas.height);
  }

  select(index, more) {
    const { selected } = this.state;
    const only = selected.size === 1 && selected.has(index);
    if (!more) selected.clear();
    if (index && !(more ? selected.delete(index) : only)) selected.add(index);
    this.redraw();
    if (index) this.rows.reveal(index);
  }

  hide(index, hidden) {
    this.state.hidden[index] = hidden;
    this.redraw();
  }

  /** Hide all that is not selected, or show everything again. */
  isolate() {
    const { hidden, selected } = this.state;
    const others = hidden.map((_, index) => !selected.has(index));
    const isolated = hidden.every((value, index) => value === others[index]);
    this.state.hidden = isolated || !selected.size ? hidden.map(() => false) : others;
    this.redraw();
  }

  move(index, by) {
    this.state.offsets[index] = add(this.state.offsets[index], by);
    this.redraw();
  }

  putBack() {
    this.state.offsets = this.state.offsets.map(() => [0, 0, 0]);
    this.state.hidden.fill(false);
    this.state.selected.clear();
    this.redraw();
  }

  /** What was done here, for `instok3d edit`, which does it to the scene folder (SCENE) itself. */
  commands() {
    const { objects } = this.scene.about, lines = [];
    const word = (text) => (/^[\w#.-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);
    objects.forEach((object, k) => {
      const offset = this.state.offsets[k + 1].map((value) => Number(value.toPrecision(4)));
      if (offset.some((value) => value)) {
        lines.push(`instok3d edit SCENE move ${word(object.key)} --by ${offset.join(" ")}`);
      }
      if (this.state.hidden[k + 1]) lines.push(`instok3d edit SCENE hide ${word(object.key)}`);
    });
    return lines;
  }

  listen() {
    const { canvas, viewpoint, state } = this;
    let last = null, moved = 0;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      last = event;
      moved = 0;
      const index = this.objectAt(event.clientX, event.clientY);
      this.dragged = this.moving && state.selected.has(index);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!last) return this.hover(event);
      const dx = event.clientX - last.clientX, dy = event.clientY - last.clientY;
      moved += Math.abs(dx) + Math.abs(dy);
      last = event;
      const height = canvas.clientHeight;
      if (this.dragged) this.drag(dx / height, dy / height, event.shiftKey);
      else if (event.buttons & 2 || event.shiftKey) viewpoint.pan(dx / height, dy / height);
      else viewpoint.orbit((-dx / height) * 3, (-dy / height) * 3);
      this.redraw();
    });
    const end = (event) => {
      if (last && moved < 4 && event.type === "pointerup") {
        this.select(this.objectAt(event.clientX, event.clientY), event.ctrlKey || event.metaKey);
      }
      last = null;
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => {
      state.hovered = 0;
      this.redraw();
    });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      viewpoint.approach(Math.exp(Math.max(-0.5, Math.min(0.5, event.deltaY / 500))));
      this.redraw();
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
    const on = (name, action) =>
      document.querySelector(name).addEventListener("click", (event) => action(event.currentTarget));
    on("#colors", (button) => this.toggle(button, (value) => { state.colored = value; }));
    on("#move", (button) => this.toggle(button, (value) => { this.moving = value; }));
    on("#isolate", () => this.isolate());
    on("#back", () => this.putBack());
    document.querySelector("#search").addEventListener("input", (event) => this.rows.filter(event.target.value));
  }

  toggle(button, set) {
    const value = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", value);
    set(value);
    this.redraw();
  }

  key(event) {
    const steps = { ArrowLeft: [-0.05, 0], ArrowRight: [0.05, 0], ArrowUp: [0, -0.05], ArrowDown: [0, 0.05] };
    const step = steps[event.key];
    if (step) this.viewpoint.orbit(3 * step[0], 3 * step[1]);
    else if (event.key === "+") this.viewpoint.approach(0.9);
    else if (event.key === "-") this.viewpoint.approach(1 / 0.9);
    else if (event.key === "Escape") this.state.selected.clear();
    else if (event.key === "h" || event.key === "Delete") this.state.selected.forEach((k) => this.hide(k, true));
    else return;
    event.preventDefault();
    this.redraw();
  }

  hover(event) {
    const index = this.objectAt(event.clientX, event.clientY);
    if (index === this.state.hovered) return;
    this.state.hovered = index;
    this.canvas.title = index ? this.scene.about.objects[index - 1].key : "";
    this.redraw();
  }

  /** Move what is selected along the floor, or with `vertical` up and down, as far as the pointer. */
  drag(right, down, vertical) {
    const { viewpoint, state, scene } = this, up = scene.about.up;
    const [first] = state.selected;
    const place = add(scene.about.objects[first - 1].centroid, state.offsets[first]);
    const depth = Math.max(1e-6, dot(viewpoint.rotation[2], add(place, viewpoint.center, -1)));
    const size = depth / viewpoint.lens[1];
    const flat = (axis) => unit(add(axis, up, -dot(axis, up)));
    const steep = Math.abs(dot(viewpoint.rotation[2], up)) > 0.95;
    const ahead = flat(steep ? scaled(viewpoint.rotation[1], -1) : viewpoint.rotation[2]);
    let by = vertical ? scaled(up, -down * size) : add(scaled(flat(viewpoint.rotation[0]), right * size), ahead, -down * size);
    state.selected.forEach((index) => this.move(index, by));
  }
}

const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);

/** The list of objects beside the picture. */
class ObjectList {
  constructor(page) {
    const list = document.querySelector("#objects");
    this.rows = page.scene.about.objects.map((object, k) => {
      const row = document.createElement("li"), eye = document.createElement("button");
      const name = document.createElement("button"), picture = document.createElement("img");
      const chip = document.createElement("i"), label = document.createElement("span"), size = document.createElement("small");
      eye.className = "eye";
      eye.addEventListener("click", () => page.hide(k + 1, !page.state.hidden[k + 1]));
      name.className = "name";
      picture.src = object.picture;
      picture.alt = "";
      chip.style.background = object.color;
      size.textContent = object.size + (object.fragment ? ", fragment" : "");
      label.append(object.key, size);
      name.append(picture, chip, label);
      name.addEventListener("click", (event) => page.select(k + 1, event.ctrlKey || event.metaKey));
      row.append(name, eye);
      return { row, eye, name, key: object.key, fragment: object.fragment };
    });
    const whole = this.rows.filter(({ fragment }) => !fragment), fragments = this.rows.filter(({ fragment }) => fragment);
    list.append(...[...whole, ...fragments].map(({ row }) => row));
  }

  show({ hidden, selected }) {
    this.rows.forEach(({ row, eye, name, key }, k) => {
      row.classList.toggle("hidden", hidden[k + 1]);
      name.setAttribute("aria-pressed", selected.has(k + 1));
      eye.textContent = hidden[k + 1] ? "show" : "hide";
      eye.setAttribute("aria-label", `${eye.textContent} ${key}`);
    });
  }

  reveal(index) {
    this.rows[index - 1].row.scrollIntoView({ block: "nearest" });
  }

  filter(text) {
    const wanted = text.trim().toLowerCase();
    for (const { row, key } of this.rows) row.hidden = !key.toLowerCase().includes(wanted);
  }
}

/** Coefficient by coefficient of each Gaussian: the constant ones, then the others. */
function harmonics({ sh_constant, sh_others }, coefficients) {
  const count = sh_constant.length / 3, sh = new Float32Array(3 * coefficients * count);
  for (let k = 0; k < count; k++) {
    sh.set(sh_constant.subarray(3 * k, 3 * k + 3), 3 * coefficients * k);
    const others = 3 * (coefficients - 1);
    sh.set(sh_others.subarray(others * k, others * (k + 1)), 3 * coefficients * k + 3);
  }
  return sh;
}

function start() {
  const read = (id) => document.getElementById(id).textContent;
  const about = JSON.parse(read("about-scene"));
  const arrays = unpack(about.layout, read("gaussians"));
  const scene = {
    about,
    means: arrays.means,
    covariances: covariances(arrays.scales, arrays.quats),
    opacities: arrays.opacities,
    sh: harmonics(arrays, about.coefficients),
    coefficients: about.coefficients,
    near: about.near_far[0],
    far: about.near_far[1],
    objects: new Uint16Array(arrays.opacities.length),
  };
  about.objects.forEach(({ gaussian_range: [first, count] }, k) => {
    scene.objects.fill(k + 1, first, first + count);
  });
  window.instok3d = new Page(scene);
}

try {
  start();
} catch (error) {
  document.querySelector("#about").textContent = `The scene cannot be shown: ${error.message}.`;
  throw error;
}
