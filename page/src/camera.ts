// Looking around: orbit about a point, walk with keys. World: metres, +z up.

import { PerspectiveCamera, Vector3 } from "three";

const KEYS: Record<string, [number, number, number]> = {
  w: [0, 1, 0], s: [0, -1, 0], a: [-1, 0, 0], d: [1, 0, 0], q: [0, 0, -1], e: [0, 0, 1],
};
const TURNS: Record<string, [number, number]> = {
  ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
};
/** Nearest to the zenith that looking goes, radians. */
const POLE = 0.02;

export class Navigator {
  target = new Vector3();
  distance = 5;
  /** Direction of the view in plan, and its height, radians. */
  yaw = 0;
  pitch = -0.5;
  onChange: () => void = () => {};
  private held = new Set<string>();
  private pointers = new Map<number, { x: number; y: number }>();
  private moved = 0;
  private home = { target: new Vector3(), distance: 5, yaw: 0, pitch: -0.5 };
  /** Metres a second. */
  speed = 2;

  constructor(readonly camera: PerspectiveCamera, private canvas: HTMLElement, private onClick: (x: number, y: number) => void) {
    camera.up.set(0, 0, 1);
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("pointermove", (e) => this.move(e));
    canvas.addEventListener("pointerup", (e) => this.up(e));
    canvas.addEventListener("pointercancel", (e) => this.pointers.delete(e.pointerId));
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.zoom(Math.exp(Math.sign(e.deltaY) * Math.min(Math.abs(e.deltaY), 100) * 0.002));
    }, { passive: false });
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("keydown", (e) => {
      if (e.ctrlKey || e.metaKey || e.altKey) return;
      const key = e.key.length === 1 ? e.key.toLowerCase() : e.key;
      if (key in KEYS || key in TURNS) {
        this.held.add(key);
        // A tap may be shorter than a frame.
        this.step(0.04);
        e.preventDefault();
      }
    });
    canvas.addEventListener("keyup", (e) => this.held.delete(e.key.length === 1 ? e.key.toLowerCase() : e.key));
    canvas.addEventListener("blur", () => this.held.clear());
  }

  setHome(target: Vector3, distance: number, yaw: number, pitch: number): void {
    this.home = { target: target.clone(), distance, yaw, pitch };
    this.goHome();
  }

  goHome(): void {
    this.target.copy(this.home.target);
    ({ distance: this.distance, yaw: this.yaw, pitch: this.pitch } = this.home);
    this.apply();
  }

  look(target: Vector3, distance: number): void {
    this.target.copy(target);
    this.distance = distance;
    this.apply();
  }

  state(): number[] {
    const t = this.target;
    return [t.x, t.y, t.z, this.distance, this.yaw, this.pitch];
  }

  restore(state: number[]): void {
    if (state.length !== 6 || !state.every((v) => Number.isFinite(v) && Math.abs(v) < 1e6)) return;
    this.target.set(state[0], state[1], state[2]);
    this.distance = Math.max(state[3], 0.01);
    this.yaw = state[4];
    this.pitch = state[5];
    this.apply();
  }

  zoom(factor: number): void {
    this.distance = Math.min(Math.max(this.distance * factor, 0.02), 1e4);
    this.apply();
  }

  /** Moves by what keys are held; true while some are. */
  step(seconds: number): boolean {
    if (this.held.size === 0) return false;
    for (const key of this.held) {
      const turn = TURNS[key];
      if (turn !== undefined) {
        this.turnInPlace(-turn[0] * seconds * 1.2, turn[1] * seconds * 0.8);
        continue;
      }
      const [right, ahead, up] = KEYS[key];
      const c = Math.cos(this.yaw), s = Math.sin(this.yaw), way = this.speed * seconds;
      this.target.x += way * (ahead * c + right * s);
      this.target.y += way * (ahead * s - right * c);
      this.target.z += way * up;
    }
    this.apply();
    return true;
  }

  /** Direction of the view. */
  private ahead(): Vector3 {
    const c = Math.cos(this.pitch);
    return new Vector3(c * Math.cos(this.yaw), c * Math.sin(this.yaw), Math.sin(this.pitch));
  }

  private turnInPlace(yaw: number, pitch: number): void {
    const eye = this.camera.position.clone();
    this.yaw += yaw;
    this.pitch = clampPitch(this.pitch + pitch);
    this.target.copy(eye).addScaledVector(this.ahead(), this.distance);
  }

  apply(): void {
    this.pitch = clampPitch(this.pitch);
    this.camera.position.copy(this.target).addScaledVector(this.ahead(), -this.distance);
    this.camera.lookAt(this.target);
    this.camera.updateMatrixWorld();
    this.onChange();
  }

  private down(e: PointerEvent): void {
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(e.pointerId);
    if (this.pointers.size === 0) this.moved = 0;
    this.pointers.set(e.pointerId, { x: e.clientX, y: e.clientY });
  }

  private move(e: PointerEvent): void {
    const last = this.pointers.get(e.pointerId);
    if (last === undefined) return;
    const dx = e.clientX - last.x, dy = e.clientY - last.y;
    this.moved += Math.abs(dx) + Math.abs(dy);
    const others = [...this.pointers.entries()].filter(([id]) => id !== e.pointerId).map(([, p]) => p);
    if (others.length > 0) {
      const before = Math.hypot(last.x - others[0].x, last.y - others[0].y);
      const after = Math.hypot(e.clientX - others[0].x, e.clientY - others[0].y);
      this.pan(dx / 2, dy / 2);
      this.zoom(before / Math.max(after, 1));
    } else if (e.buttons & 6 || e.shiftKey) {
      this.pan(dx, dy);
    } else {
      this.yaw -= dx * 0.006;
      this.pitch -= dy * 0.006;
      this.apply();
    }
    this.pointers.set(e.pointerId, { x: e.clientX, y: e.clientY });
  }

  private up(e: PointerEvent): void {
    const was = this.pointers.delete(e.pointerId);
    if (was && this.pointers.size === 0 && this.moved < 5) this.onClick(e.clientX, e.clientY);
  }

  private pan(dx: number, dy: number): void {
    const scale = (this.distance * Math.tan((this.camera.fov * Math.PI) / 360) * 2) / this.canvas.clientHeight;
    const right = new Vector3(Math.sin(this.yaw), -Math.cos(this.yaw), 0);
    const up = new Vector3().crossVectors(right, this.ahead());
    this.target.addScaledVector(right, -dx * scale).addScaledVector(up, dy * scale);
    this.apply();
  }
}

function clampPitch(pitch: number): number {
  return Math.min(Math.max(pitch, POLE - Math.PI / 2), Math.PI / 2 - POLE);
}
