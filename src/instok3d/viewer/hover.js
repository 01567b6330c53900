// Asks the server which object the pointer is over, one question at a time, and names it there.
(() => {
  let busy = false, next = null;
  const tip = document.createElement("div");
  tip.id = "instok3d-hover";
  tip.style.cssText = "position: fixed; z-index: 1000; pointer-events: none; padding: 2px 8px; " +
    "border-radius: 4px; background: #000c; color: #fff; font: 13px sans-serif";
  tip.hidden = true;

  async function ask() {
    if (busy || next === null) return;
    const { clientX, clientY, target } = next, box = target.getBoundingClientRect();
    busy = true;
    next = null;
    try {
      const x = (clientX - box.left) / box.width, y = (clientY - box.top) / box.height;
      const answer = await fetch(`/hover?x=${x}&y=${y}`);
      tip.textContent = answer.ok ? await answer.text() : "";
      tip.hidden = tip.textContent === "";
      tip.style.left = `${clientX + 14}px`;
      tip.style.top = `${clientY + 14}px`;
    } catch {
      tip.hidden = true;  // the viewer has ended
    }
    busy = false;
    ask();
  }

  addEventListener("DOMContentLoaded", () => document.body.append(tip));
  addEventListener("pointermove", (event) => {
    const over = event.target instanceof HTMLCanvasElement && event.buttons === 0;
    next = over ? event : null;
    if (!over) tip.hidden = true;
    ask();
  });
})();
