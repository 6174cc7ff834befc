/** The picture: camera, light, and a frame whenever something changed. */
import {
  AmbientLight, Box3, Color, DirectionalLight, PerspectiveCamera, Plane, Raycaster, Scene, Vector2, Vector3, WebGLRenderer,
} from 'three';
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';

const FLIGHT_MS = 450;
/** Below this rate, while the view moves, fewer points are drawn. */
const ENOUGH_FPS = 30;
/** Fewer points than this share are no picture any more: then it is drawn with half the pixels an edge. */
const LEAST_SHARE = 0.1;

export interface Frame { draws: number; points: number; fps: number; share: number }

export class Stage {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(50, 1, 0.05, 5000);
  readonly controls: OrbitControls;
  readonly renderer: WebGLRenderer;
  /** Share of the budget that the machine keeps up with, 0 to 1. */
  share = 1;
  frame: Frame = { draws: 0, points: 0, fps: 0, share: 1 };
  readonly beforeFrame = new Set<(moving: boolean) => void>();
  readonly afterFrame = new Set<() => void>();
  private coarse = false;
  private readonly pixelRatio: number;
  private wanted = true;
  private movedAt = 0;
  private last = 0;
  private flight: { from: [Vector3, Vector3]; to: [Vector3, Vector3]; begun: number } | null = null;

  constructor(readonly host: HTMLElement) {
    const soft = softwareContext();
    this.renderer = new WebGLRenderer(soft ?? { antialias: devicePixelRatio < 2, powerPreference: 'high-performance' });
    this.pixelRatio = soft ? 1 : Math.min(devicePixelRatio, 2);
    this.renderer.setPixelRatio(this.pixelRatio);
    // Asking after each program whether it is right waits until it is.
    this.renderer.debug.checkShaderErrors = false;
    host.prepend(this.renderer.domElement);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(-4, -9, 10);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    Object.assign(this.controls, { enableDamping: true, dampingFactor: 0.15, zoomToCursor: true, screenSpacePanning: false, maxPolarAngle: Math.PI * 0.98 });
    this.controls.addEventListener('change', () => { this.movedAt = performance.now(); this.wanted = true; });
    this.controls.addEventListener('start', () => { this.flight = null; });
    const sun = new DirectionalLight(0xffffff, 1.6);
    sun.position.set(2, -3, 6);
    this.scene.add(new AmbientLight(0xffffff, 1.4), sun);
    new ResizeObserver(() => this.fit()).observe(host);
    this.fit();
    const dark = matchMedia('(prefers-color-scheme: dark)');
    const ground = (): void => {
      this.scene.background = new Color(dark.matches ? '#10151c' : '#eef1f4');
      this.wanted = true;
    };
    dark.addEventListener('change', ground);
    ground();
    requestAnimationFrame(time => this.tick(time));
  }

  /** Asks for a frame. */
  draw(): void { this.wanted = true; }

  private fit(): void {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (!width || !height) return;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.wanted = true;
  }

  private tick(time: number): void {
    requestAnimationFrame(next => this.tick(next));
    this.fly(time);
    this.controls.update();
    const moving = time - this.movedAt < 200;
    const span = time - this.last;
    if (!this.wanted) { this.last = time; return; }
    this.wanted = false;
    // Two frames in a row tell how fast the machine is; a pause between them tells nothing.
    if (moving && span < 4000) {
      const fps = 1000 / Math.max(span, 1);
      this.frame.fps = this.frame.fps ? 0.7 * this.frame.fps + 0.3 * fps : fps;
      // Far too slow is mended at once, a little too slow little by little.
      if (this.frame.fps < ENOUGH_FPS) this.share = Math.max(LEAST_SHARE, this.share * Math.max(0.4, Math.min(0.95, Math.sqrt(fps / ENOUGH_FPS))));
      else if (this.frame.fps > ENOUGH_FPS * 1.3) this.share = Math.min(1, this.share * 1.05);
    }
    this.last = time;
    this.sharpen(moving);
    this.near();
    for (const each of this.beforeFrame) each(moving);
    this.renderer.render(this.scene, this.camera);
    this.frame.draws = this.renderer.info.render.calls;
    this.frame.points = this.renderer.info.render.points;
    this.frame.share = moving ? this.share : 1;
    for (const each of this.afterFrame) each();
    // Once the view rests, all points are drawn.
    if (moving) setTimeout(() => this.draw(), 250);
  }

  private sharpen(moving: boolean): void {
    const coarse = moving && this.share <= 2 * LEAST_SHARE && (this.coarse || this.frame.fps < ENOUGH_FPS / 2);
    if (coarse === this.coarse) return;
    this.coarse = coarse;
    this.renderer.setPixelRatio(this.pixelRatio * (coarse ? 0.5 : 1));
  }

  /** Near and far planes that fit the distance: depth has no digits to spare. */
  private near(): void {
    const distance = this.camera.position.distanceTo(this.controls.target);
    this.camera.near = Math.max(0.02, distance / 200);
    this.camera.far = Math.max(200, distance * 60);
    this.camera.updateProjectionMatrix();
  }

  /** Moves the camera there, over a moment. */
  flyTo(target: Vector3, position: Vector3): void {
    this.flight = {
      from: [this.controls.target.clone(), this.camera.position.clone()], to: [target.clone(), position.clone()], begun: performance.now(),
    };
    this.wanted = true;
  }

  private fly(time: number): void {
    if (!this.flight) return;
    const part = Math.min(1, Math.max(0, (time - this.flight.begun) / FLIGHT_MS));
    const eased = part * part * (3 - 2 * part);
    const { from, to } = this.flight;
    this.controls.target.lerpVectors(from[0], to[0], eased);
    this.camera.position.lerpVectors(from[1], to[1], eased);
    this.movedAt = time;
    this.wanted = true;
    if (part === 1) this.flight = null;
  }

  /** Shows a box whole: from the side that is looked from now, or from above. */
  frameBox(box: Box3, fromAbove = false): void {
    if (box.isEmpty()) return;
    const away = this.camera.position.clone().sub(this.controls.target).setZ(0);
    if (!away.lengthSq()) away.set(-0.3, -1, 0);
    // Not straight down, where left and right would be undefined.
    const towards = fromAbove ? new Vector3(0, -0.001, 1) : away.normalize().setZ(1.05).normalize();
    const right = new Vector3(0, 0, 1).cross(towards).normalize(), up = towards.clone().cross(right);
    const corners = Array.from({ length: 8 }, (_, i) => new Vector3(
      i & 1 ? box.max.x : box.min.x, i & 2 ? box.max.y : box.min.y, i & 4 ? box.max.z : box.min.z));
    const high = Math.tan(this.camera.fov * Math.PI / 360), wide = high * this.camera.aspect;
    const target = box.getCenter(new Vector3());
    let distance = box.getSize(new Vector3()).length() + 0.5;
    // What is near looks larger than what is far: the middle of what is seen is found step by step.
    for (let step = 0; step < 12; step++) {
      let left = Infinity, most = -Infinity, low = Infinity, top = -Infinity;
      for (const corner of corners) {
        const at = corner.clone().sub(target), depth = Math.max(0.05 * distance, distance - at.dot(towards));
        const x = at.dot(right) / depth / wide, y = at.dot(up) / depth / high;
        left = Math.min(left, x); most = Math.max(most, x); low = Math.min(low, y); top = Math.max(top, y);
      }
      target.addScaledVector(right, (left + most) / 2 * distance * wide);
      // A little higher than the middle: the slider lies below.
      target.addScaledVector(up, ((low + top) / 2 - 0.05) * distance * high);
      distance *= Math.max((most - left) / 2 / 0.94, (top - low) / 2 / 0.88);
    }
    this.flyTo(target, target.clone().addScaledVector(towards, Math.max(1, distance)));
  }

  /** Moves camera and target together, as what is followed moves. */
  shift(by: Vector3): void {
    this.controls.target.add(by);
    this.camera.position.add(by);
    this.wanted = true;
  }

  /** A point of the page in the camera's coordinates, -1 to 1. */
  ndc(x: number, y: number): Vector2 {
    const box = this.renderer.domElement.getBoundingClientRect();
    return new Vector2((x - box.left) / box.width * 2 - 1, 1 - (y - box.top) / box.height * 2);
  }

  ray(x: number, y: number): Raycaster {
    const caster = new Raycaster();
    caster.setFromCamera(this.ndc(x, y), this.camera);
    return caster;
  }

  /** Where a ray meets a level ground. */
  ground(x: number, y: number, z: number): Vector3 | null {
    return this.ray(x, y).ray.intersectPlane(new Plane(new Vector3(0, 0, 1), -z), new Vector3());
  }

  /** Where a place is drawn, pixels from the canvas's corner; nothing behind the camera. */
  screen(place: Vector3): { x: number; y: number } | null {
    const at = place.clone().project(this.camera);
    if (at.z > 1 || at.z < -1) return null;
    return { x: (at.x + 1) / 2 * this.host.clientWidth, y: (1 - at.y) / 2 * this.host.clientHeight };
  }

  /** Metres of one pixel at a place. */
  metresPerPixel(place: Vector3): number {
    const distance = Math.max(this.camera.near, this.camera.position.distanceTo(place));
    return 2 * Math.tan(this.camera.fov * Math.PI / 360) * distance / Math.max(1, this.host.clientHeight);
  }
}

/** A context without smooth edges, if the browser draws without a graphics processor: they would cost four times the work. */
function softwareContext(): { canvas: HTMLCanvasElement; context: WebGL2RenderingContext } | null {
  const canvas = document.createElement('canvas');
  const context = canvas.getContext('webgl2', { antialias: false, alpha: true, depth: true, stencil: false });
  const info = context?.getExtension('WEBGL_debug_renderer_info');
  const name = context && info ? String(context.getParameter(info.UNMASKED_RENDERER_WEBGL)) : '';
  if (context && /swiftshader|llvmpipe|software|basic render/i.test(name)) return { canvas, context };
  context?.getExtension('WEBGL_lose_context')?.loseContext();
  return null;
}
