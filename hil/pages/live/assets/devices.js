// The device as it stands: a motor as a dial, a haptic wall from the side, any other plant as bars of its states.
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const most = new WeakMap(); // of each canvas: the largest value of every state so far

export function drawDevice(canvas, about, states, given) {
  const ctx = canvas.getContext("2d"), size = canvas.width;
  ctx.clearRect(0, 0, size, size);
  ctx.lineCap = "round";
  if (!Object.keys(states).length) return canvas.setAttribute("aria-label", "Device: no state yet");
  const draw = about.wall && "position" in states ? wall : "angle" in states ? dial : bars;
  canvas.setAttribute("aria-label", draw(ctx, size, states, about, canvas, given));
}

const REACH = 0.03; // m that the picture of a wall shows on each side

// The mouse is the hand: while it is pressed, the hand means to be where the mouse is. Its spring and damper stay between the two,
// and it takes `approach_s` to get there, so that a jump of the mouse is no impulse.
export function makeTouch(canvas, about, apply) {
  if (!about.wall || !("plant.hand.reach_m" in about.fields)) return;
  let wanted = null, busy = false;
  const send = async () => {
    if (busy || wanted === null) return;
    busy = true;
    const reach = wanted;
    wanted = null;
    await apply("plant.hand.reach_m", reach);
    setTimeout(() => { busy = false; send(); }, 60);
  };
  canvas.style.cursor = "grab";
  canvas.style.touchAction = "none";
  canvas.addEventListener("pointerdown", async (event) => {
    canvas.setPointerCapture(event.pointerId);
    if (!makeTouch.quick) await apply("plant.hand.approach_s", 0.15);
    makeTouch.quick = true;
    move(event);
  });
  const move = (event) => {
    if (!event.buttons) return;
    const box = canvas.getBoundingClientRect();
    wanted = +(((event.clientX - box.left) / box.width - 0.5) * 2 * REACH).toFixed(5);
    send();
  };
  canvas.addEventListener("pointermove", move);
}

function dial(ctx, size, states, about) {
  const c = size / 2, r = 0.38 * size;
  ctx.lineWidth = 6;
  ctx.strokeStyle = css("--line");
  ctx.beginPath();
  ctx.arc(c, c, r, 0, 2 * Math.PI);
  ctx.stroke();
  ctx.strokeStyle = css("--muted");
  ctx.lineWidth = 2;
  for (let i = 0; i < 12; i++) hand(ctx, c, (i * Math.PI) / 6, 0.92 * r, r);
  ctx.lineWidth = 10;
  ctx.strokeStyle = css("--c0");
  hand(ctx, c, states.angle, 0, 0.86 * r);
  const x = c + 0.86 * r * Math.sin(states.angle), y = c - 0.86 * r * Math.cos(states.angle);
  ctx.fillStyle = css("--c1"); // the load at the end of the lever
  ctx.beginPath();
  ctx.arc(x, y, 0.07 * size, 0, 2 * Math.PI);
  ctx.fill();
  ctx.fillStyle = css("--text");
  ctx.beginPath();
  ctx.arc(c, c, 0.05 * size, 0, 2 * Math.PI);
  ctx.fill();
  return `Motor at ${states.angle.toPrecision(3)} rad`;
}

function hand(ctx, c, angle, from, to) {
  ctx.beginPath();
  ctx.moveTo(c + from * Math.sin(angle), c - from * Math.cos(angle));
  ctx.lineTo(c + to * Math.sin(angle), c - to * Math.cos(angle));
  ctx.stroke();
}

// From the side: free space on the left, the wall on the right in the colours of its materials, the device as a disc.
function wall(ctx, size, states, about, canvas, given) {
  const pattern = about.wall.pattern, at = (x) => size / 2 + (x / REACH) * (size / 2);
  const material = pattern ? under(pattern, states.y, states.z) : about.wall.material || 0;
  const tall = pattern ? pattern.height_m : 1;
  for (const patch of pattern ? pattern.patches : [{ y_m: 0, z_m: 0, width_m: 1, height_m: 1, material }]) {
    const here = !pattern || (mod(states.y, pattern.width_m) >= patch.y_m && mod(states.y, pattern.width_m) < patch.y_m + patch.width_m);
    ctx.globalAlpha = here ? 0.55 : 0.15;
    ctx.fillStyle = css(`--c${patch.material % 8}`);
    ctx.fillRect(size / 2, size * (1 - (patch.z_m + patch.height_m) / tall), size / 2, (size * patch.height_m) / tall);
  }
  ctx.globalAlpha = 1;
  ctx.strokeStyle = css("--muted");
  ctx.lineWidth = 3;
  ctx.beginPath();
  ctx.moveTo(size / 2, 0);
  ctx.lineTo(size / 2, size);
  ctx.stroke();
  const z = pattern ? size * (1 - mod(states.z, tall) / tall) : size / 2, x = Math.min(Math.max(at(states.position), 14), size - 14);
  ctx.strokeStyle = css("--text"); // avatar: what of the device the wall lets through
  ctx.setLineDash([5, 5]);
  ctx.beginPath();
  ctx.arc(Math.min(x, size / 2), z, 13, 0, 2 * Math.PI);
  ctx.stroke();
  ctx.setLineDash([]);
  ctx.fillStyle = css("--text");
  ctx.beginPath();
  ctx.arc(x, z, 10, 0, 2 * Math.PI);
  ctx.fill();
  if (given != null) energy(ctx, size, given, about.limits.given);
  return `Device ${states.position > 0 ? `${(1e3 * states.position).toPrecision(3)} mm in material ${material}` : "in free space"}`;
}

// The passivity observer: energy that the wall has given beyond what damping took. A passive wall gives none.
export const energyWords = (most) => most > 1e-9
  ? `✗ the wall has given ${(1e3 * most).toPrecision(3)} mJ more than damping took: not passive`
  : "✓ the wall has given no energy: passive so far";

function energy(ctx, size, given, limit) {
  const full = limit || 0.01, share = Math.min(given / full, 1), tall = 0.8 * size, top = 0.1 * size;
  ctx.lineWidth = 2;
  ctx.strokeStyle = css("--muted");
  ctx.strokeRect(10, top, 16, tall);
  ctx.fillStyle = css("--bad");
  ctx.fillRect(11, top + tall * (1 - share), 14, tall * share);
  ctx.fillStyle = css("--text");
  ctx.font = `${Math.round(0.04 * size)}px ${css("--sans")}`;
  ctx.fillText(`${(1e3 * full).toPrecision(2)} mJ`, 8, top - 6);
  ctx.fillText("energy given", 8, top + tall + 0.05 * size);
}

const mod = (v, n) => ((v % n) + n) % n;
function under(pattern, y, z) {
  const at = pattern.patches.find((p) => mod(y, pattern.width_m) >= p.y_m && mod(y, pattern.width_m) < p.y_m + p.width_m &&
    mod(z, pattern.height_m) >= p.z_m && mod(z, pattern.height_m) < p.z_m + p.height_m);
  return at ? at.material : 0;
}

function bars(ctx, size, states, about, canvas) {
  const seen = most.get(canvas) || most.set(canvas, {}).get(canvas), names = Object.keys(states).slice(0, 8), tall = size / names.length;
  ctx.font = `${Math.min(0.3 * tall, 24)}px ${css("--sans")}`;
  names.forEach((name, i) => {
    const largest = about.limits[name] || (seen[name] = Math.max(seen[name] || 1e-9, Math.abs(states[name])));
    const long = Math.max(-1, Math.min(1, states[name] / largest)) * size * 0.48, y = i * tall;
    ctx.fillStyle = css("--line-soft");
    ctx.fillRect(0, y + 0.4 * tall, size, 0.4 * tall);
    ctx.fillStyle = css(`--c${i % 8}`);
    ctx.fillRect(size / 2, y + 0.4 * tall, long, 0.4 * tall);
    ctx.fillStyle = css("--text");
    ctx.fillText(name, 4, y + 0.32 * tall);
  });
  return names.map((name) => `${name} ${states[name].toPrecision(3)}`).join(", ");
}
