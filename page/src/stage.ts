// The scene on the screen: three.js and Spark.

import {
  Box3, BufferGeometry, Color, Float32BufferAttribute, Group, LineBasicMaterial, LineSegments,
  Matrix4, PerspectiveCamera, Quaternion, Ray, Scene, Vector3, WebGLRenderer,
} from "three";
import { PackedSplats, RgbaArray, SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
import { rotationOf, scaleOf, type SceneData } from "./data";
import { Navigator } from "./camera";
import { facing, roomOf, wholeFrom, type Room } from "./room";

const EDGES = [0, 1, 1, 2, 2, 3, 3, 0, 4, 5, 5, 6, 6, 7, 7, 4, 0, 4, 1, 5, 2, 6, 3, 7];

export class Stage {
  readonly navigator: Navigator;
  readonly paint: Uint8Array;
  /** Scene frame and unit → metres, +z up. */
  readonly toWorld: Matrix4;
  frames = 0;
  /** What is seen into from outside; null without walls. */
  readonly room: Room | null;
  /** Whether walls and ceiling before the camera are cut away. */
  cuts = true;
  /** Other sides of the room than before are to be cut away. */
  onCut: () => void = () => {};
  private away = 0;
  private renderer: WebGLRenderer;
  private spark: SparkRenderer;
  private scene = new Scene();
  private camera: PerspectiveCamera;
  private mesh!: SplatMesh;
  private rgba: RgbaArray;
  private outlines = new Group();
  private measured = new Group();
  private dirty = 4;
  private last = 0;
  private resizing = new ResizeObserver(() => this.resize());

  private constructor(
    private data: SceneData, private canvas: HTMLCanvasElement, onClick: (row: number) => void,
  ) {
    const n = data.about.count;
    this.renderer = new WebGLRenderer({ canvas, antialias: false, preserveDrawingBuffer: true });
    this.renderer.setClearColor(new Color(0x14161a), 1);
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.spark = new SparkRenderer({ renderer: this.renderer, onDirty: () => this.wake() });
    this.scene.add(this.spark, this.outlines, this.measured);
    this.camera = new PerspectiveCamera(55, 1, 0.02, 5000);
    this.navigator = new Navigator(this.camera, canvas, (x, y) => onClick(this.pick(x, y)));
    this.navigator.onChange = () => this.wake();
    this.toWorld = worldOf(data);
    this.room = roomOf(data);
    const capacity = textureRows(n);
    this.paint = new Uint8Array(4 * capacity);
    this.rgba = new RgbaArray({ array: this.paint, count: n, capacity });
    this.resizing.observe(canvas);
  }

  static async open(data: SceneData, canvas: HTMLCanvasElement, onClick: (row: number) => void): Promise<Stage> {
    const stage = new Stage(data, canvas, onClick);
    const n = data.about.count;
    const splats = new PackedSplats({ maxSplats: n });
    await splats.initialized;
    splats.ensureSplats(n);
    const center = new Vector3(), scales = new Vector3(), turn = new Quaternion(), color = new Color();
    // 16-bit places are finest about 0.
    const middle = middleOf(data);
    for (let i = 0; i < n; i++) {
      center.fromArray(data.position, 3 * i).sub(middle);
      scales.fromArray(scaleOf(data, i));
      const [w, x, y, z] = rotationOf(data, i);
      turn.set(x, y, z, w);
      color.setRGB(data.color[4 * i] / 255, data.color[4 * i + 1] / 255, data.color[4 * i + 2] / 255);
      splats.setSplat(i, center, scales, turn, data.color[4 * i + 3] / 255, color);
    }
    splats.numSplats = n;
    splats.needsUpdate = true;
    stage.mesh = new SplatMesh({ packedSplats: splats, raycastable: false });
    await stage.mesh.initialized;
    stage.paint.set(data.color);
    stage.mesh.splatRgba = stage.rgba;
    stage.mesh.applyMatrix4(stage.toWorld.clone().multiply(new Matrix4().makeTranslation(middle)));
    stage.scene.add(stage.mesh);
    stage.repaint();
    stage.resize();
    stage.homeView();
    stage.renderer.setAnimationLoop((time) => stage.frame(time));
    return stage;
  }

  /** Gives the graphics processor back, after the sort that runs: it reads from there, and would fail. */
  async close(): Promise<void> {
    this.renderer.setAnimationLoop(null);
    this.resizing.disconnect();
    const until = performance.now() + 5000;
    const busy = () => (this.spark.sorting || this.spark.sortTimeoutId !== -1) && !this.renderer.getContext().isContextLost();
    while (busy() && performance.now() < until) await new Promise((done) => setTimeout(done, 10));
    this.spark.dispose();
    this.mesh.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  /** Shows what `paint` holds now. */
  repaint(): void {
    this.rgba.needsUpdate = true;
    this.mesh.updateVersion();
    this.wake();
  }

  /** The sides of the room that are to be cut away now, as bits. */
  cutAway(): number {
    return this.room !== null && this.cuts ? facing(this.room, this.camera.position.toArray()) : 0;
  }

  /** What is seen, in the pixels of the canvas. */
  picture(): Promise<Blob> {
    this.renderer.render(this.scene, this.camera);
    return new Promise((done, fail) => this.canvas.toBlob((blob) => {
      if (blob === null) fail(new Error("the browser gives no picture of the canvas"));
      else done(blob);
    }, "image/png"));
  }

  wake(): void {
    // Colours and order come a frame or two late.
    this.dirty = 4;
  }

  /** Boxes of the given corners, in the frame of the scene. */
  outline(boxes: number[][][], color: number): void {
    this.lines(this.outlines, boxes.flatMap((corners) => EDGES.map((i) => corners[i])), color);
  }

  /** A line between two places in the frame of the scene; none without them. */
  measure(ends: number[][]): void {
    this.lines(this.measured, ends, 0x5aa2f2);
  }

  /** Lines between the places of each pair, in the place of those of the group. */
  private lines(group: Group, places: number[][], color: number): void {
    for (const old of group.children) if (old instanceof LineSegments) old.geometry.dispose();
    group.clear();
    if (places.length > 0) {
      const p = new Vector3();
      const at = places.flatMap((place) => p.fromArray(place).applyMatrix4(this.toWorld).toArray());
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new Float32BufferAttribute(at, 3));
      const lines = new LineSegments(geometry, new LineBasicMaterial({ color, depthTest: false, transparent: true }));
      lines.renderOrder = 10;
      group.add(lines);
    }
    this.wake();
  }

  /** A look at some corners from where the camera is. */
  lookAt(corners: number[][]): void {
    const box = new Box3();
    for (const c of corners) box.expandByPoint(new Vector3().fromArray(c).applyMatrix4(this.toWorld));
    const size = box.getSize(new Vector3()).length();
    this.navigator.look(box.getCenter(new Vector3()), Math.max(size * 1.6, 0.6));
  }

  /** The Gaussian that is seen at a place of the window, −1 = none. */
  pick(x: number, y: number): number {
    const rect = this.canvas.getBoundingClientRect();
    const ndc = [((x - rect.left) / rect.width) * 2 - 1, 1 - ((y - rect.top) / rect.height) * 2];
    const from = new Vector3().setFromMatrixPosition(this.camera.matrixWorld);
    const to = new Vector3(ndc[0], ndc[1], 0.5).unproject(this.camera).sub(from);
    const ray = new Ray(from, to).applyMatrix4(this.toWorld.clone().invert());
    ray.direction.normalize();
    const { origin: o, direction: d } = ray;
    const { position, scale, scales, about: { count: n } } = this.data;
    const hits: [number, number, number][] = [];
    for (let i = 0, at = 0; i < n; i++, at += 3) {
      const opacity = this.paint[4 * i + 3];
      if (opacity < 12) continue;
      const px = position[at] - o.x, py = position[at + 1] - o.y, pz = position[at + 2] - o.z;
      const t = px * d.x + py * d.y + pz * d.z;
      if (t <= 0) continue;
      const off = px * px + py * py + pz * pz - t * t;
      // A ball as large as the middle axis: exact enough for a finger.
      const a = scales[scale[i]], b = scales[scale[n + i]], c = scales[scale[2 * n + i]];
      const s = Math.max(Math.min(a, b), Math.min(Math.max(a, b), c));
      const spread = s * s + 1e-6 * t * t;
      if (off > 9 * spread) continue;
      hits.push([t, i, (opacity / 255) * Math.exp(-0.5 * off / spread)]);
    }
    hits.sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    let through = 1, best = -1, most = 0;
    for (const [, i, alpha] of hits) {
      const weight = through * alpha;
      if (weight > most) {
        most = weight;
        best = i;
      }
      through -= weight;
      if (through < 0.1) break;
    }
    return most > 0.03 ? best : -1;
  }

  pickCenter(): number {
    const rect = this.canvas.getBoundingClientRect();
    return this.pick(rect.left + rect.width / 2, rect.top + rect.height / 2);
  }

  /** Where a row of the scene is on the page, pixels; `null` behind the camera. */
  project(row: number): [number, number] | null {
    const p = new Vector3().fromArray(this.data.position, 3 * row).applyMatrix4(this.toWorld).project(this.camera);
    const rect = this.canvas.getBoundingClientRect();
    if (p.z > 1) return null;
    return [rect.left + ((p.x + 1) / 2) * rect.width, rect.top + ((1 - p.y) / 2) * rect.height];
  }

  private frame(time: number): void {
    const seconds = Math.min((time - this.last) / 1000, 0.2);
    this.last = time;
    if (this.navigator.step(seconds)) this.wake();
    const away = this.cutAway();
    if (away !== this.away) {
      this.away = away;
      this.onCut();
    }
    if (this.dirty <= 0) return;
    this.dirty--;
    this.renderer.render(this.scene, this.camera);
    this.frames++;
  }

  private resize(): void {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    if (w === 0 || h === 0) return;
    this.renderer.setSize(w, h, false);
    this.camera.aspect = w / h;
    this.camera.updateProjectionMatrix();
    this.wake();
  }

  private homeView(): void {
    const [low, high] = coreOf(this.data, this.toWorld);
    const size = high.clone().sub(low);
    const box = this.room ?? { yaw: 0, low: low.toArray(), high: high.toArray() };
    const middle = new Vector3(...box.low).add(new Vector3(...box.high)).multiplyScalar(0.5);
    middle.applyAxisAngle(new Vector3(0, 0, 1), box.yaw);
    const reach = Math.max(size.x, size.y, size.z);
    const slope = Math.tan((this.camera.fov * Math.PI) / 360);
    const yaw = box.yaw + 0.9, pitch = -0.75;
    const distance = wholeFrom(box, yaw, pitch, [slope * this.camera.aspect, slope]);
    this.navigator.speed = Math.max(reach / 4, 0.3);
    this.navigator.setHome(middle, Math.max(distance, 0.05), yaw, pitch);
  }
}

/** Places of the texture that colors of so many Gaussians go to: whole lines of 2048, from 2048 lines on whole layers. */
function textureRows(count: number): number {
  const line = 2048, layer = line * line;
  const whole = count > layer ? layer : line;
  return Math.ceil(Math.max(count, 1) / whole) * whole;
}

function worldOf(data: SceneData): Matrix4 {
  const m = data.about.metresPerUnit, [x, y, z] = data.about.up;
  return new Matrix4().set(
    x[0] * m, x[1] * m, x[2] * m, 0, y[0] * m, y[1] * m, y[2] * m, 0,
    z[0] * m, z[1] * m, z[2] * m, 0, 0, 0, 0, 1,
  );
}

/** Where most of the scene is: from 3 to 97 % along each axis, grown a little. */
function coreOf(data: SceneData, to: Matrix4): [Vector3, Vector3] {
  const step = Math.max(1, Math.floor(data.about.count / 20000));
  const values: number[][] = [[], [], []];
  const p = new Vector3();
  for (let i = 0; i < data.about.count; i += step) {
    p.fromArray(data.position, 3 * i).applyMatrix4(to);
    values[0].push(p.x);
    values[1].push(p.y);
    values[2].push(p.z);
  }
  const span = values.map((v) => {
    v.sort((a, b) => a - b);
    const at = (q: number) => v[Math.floor((v.length - 1) * q)] ?? 0;
    return [at(0.03), at(0.97)];
  });
  return [new Vector3(span[0][0], span[1][0], span[2][0]), new Vector3(span[0][1], span[1][1], span[2][1])];
}

function middleOf(data: SceneData): Vector3 {
  const [low, high] = coreOf(data, new Matrix4());
  return low.add(high).multiplyScalar(0.5);
}
