/** One session in the picture: its layers, in its own map frame. */
import { Box3, Group, Vector3 } from 'three';
import { rgb, type Rgb } from './colours';
import { poseAt, rotation, translation, type Placed } from './geometry';
import { RoomLayer, ZoneLayer } from './layers/areas';
import { CloudLayer } from './layers/cloud';
import { CloudLoader } from './layers/cloud_loader';
import { GridLayer } from './layers/grid';
import { PlanLayer } from './layers/plan';
import { RobotLayer } from './layers/robot';
import { PassTimes, type ColourBy, type Range, type Shades } from './layers/shading';
import { ThingLayer } from './layers/things';
import { VolumeLayer, type Volume } from './layers/volumes';
import { KeyframeLayer, LoopLayer, TrajectoryLayer } from './layers/way';
import type { Settings } from './settings';
import type { Stage } from './stage';
import type { SessionData } from './state/session';
import type { Thing, Vector2 } from './types';

/** Where there is a ceiling, what is above this height over the floor is cut away, as in the server's pictures, metres. */
const CUT_M = 2.2;

export class View {
  readonly group = new Group();
    readonly rgb: Rgb;
  readonly cloud: CloudLayer;
  readonly loader: CloudLoader;
  readonly grid: GridLayer;
  readonly robot: RobotLayer;
  readonly trajectory: TrajectoryLayer;
  readonly keyframes: KeyframeLayer;
  readonly loops: LoopLayer;
  readonly things: ThingLayer;
  readonly rooms: RoomLayer;
  readonly zones: ZoneLayer;
  readonly plan: PlanLayer;
  readonly volumes: VolumeLayer[];
  /** Height of the floor, metres, map frame. */
  floor = 0;
  height: Range = { min: 0, max: 1 };
  brightness: Range = { min: 0, max: 1 };
  chosenThing: string | null = null;
  draft: Vector2[] = [];
  /** Things as they were at the time of the slider; nothing while it is live. */
  pastThings: Thing[] | null = null;
  /** Enough of the way lies under something: a camera that looks ahead sees little of what is overhead. */
  private roofed = false;
  private measured = '';
  private times: PassTimes | null = null;
  private dirty = new Set<'way' | 'things' | 'rooms' | 'zones'>();

  constructor(
    readonly data: SessionData, readonly colour: string, private stage: Stage, private settings: Settings, problem: (text: string) => void, first: () => void,
  ) {
    this.rgb = rgb(colour);
    const { id, signal } = data;
    this.cloud = new CloudLayer(stage, () => this.shades());
    this.grid = new GridLayer(id, stage, signal, () => this.settings.tell('changed', undefined));
    this.robot = new RobotLayer(stage, this.colour);
    this.trajectory = new TrajectoryLayer(stage, this.rgb);
    this.keyframes = new KeyframeLayer(stage, this.rgb);
    this.loops = new LoopLayer(stage);
    this.things = new ThingLayer(stage);
    this.rooms = new RoomLayer(stage);
    this.zones = new ZoneLayer(stage);
    this.plan = new PlanLayer(stage);
    this.volumes = (['surface', 'voxels', 'heights'] as Volume[]).map(kind => new VolumeLayer(id, kind, stage, signal, problem));
    this.group.add(this.cloud.group, this.grid.group, this.robot.group, this.trajectory.group, this.keyframes.group, this.loops.group,
      this.things.group, this.rooms.group, this.zones.group, this.plan.group, ...this.volumes.map(v => v.group));
    this.loader = new CloudLoader(id, this.cloud, signal, () => settings.budget, () => this.eye(), () => { this.measure(); first(); });
    this.listen();
    this.apply();
  }

  private listen(): void {
    const { data } = this;
    data.on('pose', () => { if (this.settings.time_s === null) this.robot.place(this.placed()); });
    data.on('trajectory', () => this.dirty.add('way'));
    data.on('keyframes', () => this.dirty.add('way'));
    data.on('loops', () => this.dirty.add('way'));
    data.on('things', () => this.dirty.add('things'));
    data.on('rooms', () => this.dirty.add('rooms'));
    data.on('session', session => {
      this.robot.setSensors(session.sensors);
      this.dirty.add('zones');
    });
    data.on('map', () => { this.loader.touch(); this.grid.touch(); for (const volume of this.volumes) volume.touch(); });
    // Events come faster than the eye sees: what they change is drawn anew a few times a second.
    const timer = setInterval(() => {
      this.redraw();
      // Once the way is known, and whenever there is half as much again.
      const grown = `${this.data.trajectory.length > 0}/${Math.round(Math.log(1 + this.cloud.count) / Math.log(1.5))}`;
      if (grown !== this.measured) { this.measured = grown; this.measure(); }
    }, 200);
    data.signal.addEventListener('abort', () => clearInterval(timer));
  }

  has(kind: Volume): boolean {
    const map = this.data.session?.params?.map;
    return !!{ surface: map?.surface, voxels: map?.voxels, heights: map?.height }[kind]?.enabled;
  }

  redraw(): void {
    const until = this.settings.time_s;
    if (this.dirty.delete('way')) {
      this.trajectory.set(this.data.trajectory, until);
      this.keyframes.set(this.data.keyframes.values(), until);
      this.loops.set(this.data.loops.values(), this.data.keyframes, until);
      this.robot.place(this.placed());
    }
    if (this.dirty.delete('things')) {
      this.things.set(this.pastThings ?? [...this.data.things.values()], this.chosenThing);
      if (this.settings.colourBy === 'class') this.cloud.recolour();
    }
    if (this.dirty.delete('rooms')) this.rooms.set(this.data.rooms);
    if (this.dirty.delete('zones')) {
      const masks = (this.data.session?.zone_masks ?? []).flatMap(({ geometry: g }) => g ? [[[0, 0], [1, 0], [1, 1], [0, 1]].map(([x, y]) => ({
        x: (g.origin?.x ?? 0) + x! * g.width * g.resolution_m, y: (g.origin?.y ?? 0) + y! * g.height * g.resolution_m,
      }))] : []);
      this.zones.set(this.data.session?.zones ?? [], this.draft, masks);
    }
  }

  refresh(...what: ('way' | 'things' | 'rooms' | 'zones')[]): void { for (const each of what) this.dirty.add(each); this.redraw(); }

  /** Where the robot is, or was at the time of the slider. */
  placed(): Placed | null {
    if (this.settings.time_s !== null) return poseAt(this.data.trajectory, this.settings.time_s);
    const pose = this.data.pose;
    return pose?.t_map_base ? { position: translation(pose.t_map_base), rotation: rotation(pose.t_map_base), lost: pose.state === 'TRACKING_STATE_LOST' } : null;
  }

  /** What the settings say is shown. */
  apply(): void {
    const { layers } = this.settings;
    const groups: [keyof typeof layers, Group][] = [
      ['points', this.cloud.group], ['grid', this.grid.group], ['robot', this.robot.group], ['trajectory', this.trajectory.group],
      ['keyframes', this.keyframes.group], ['loops', this.loops.group], ['things', this.things.group], ['rooms', this.rooms.group], ['zones', this.zones.group],
    ];
    for (const [name, group] of groups) group.visible = layers[name];
    if (layers.robot) this.robot.place(this.placed());
    for (const volume of this.volumes) volume.group.visible = layers[volume.kind] && this.has(volume.kind);
    this.cut();
    this.stage.draw();
  }

  private cut(): void {
    const { cut_m } = this.settings;
    this.cloud.style.top.value = cut_m !== null ? this.floor + cut_m : this.roofed ? this.floor + CUT_M : 1e9;
    this.stage.draw();
  }

  /** Floor, and the range of heights and brightness, from what is loaded. */
  measure(): void {
    const heights: number[] = [], bright: number[] = [];
    for (const part of this.cloud.parts.values()) {
      const step = Math.max(1, Math.floor(this.cloud.count / 20_000));
      for (let i = 0; i < part.count; i += step) {
        heights.push(part.positions[3 * i + 2]!);
        if (part.bright) bright.push(part.bright[i]!);
      }
    }
    const at = (values: number[], share: number): number => values[Math.floor(share * (values.length - 1))] ?? 0;
    heights.sort((a, b) => a - b);
    bright.sort((a, b) => a - b);
    this.floor = floorOf(heights, this.data.pose?.t_map_base?.translation?.z ?? 0);
    this.roofed = this.isRoofed();
    this.cut();
    const seen = heights.filter(z => z <= this.cloud.style.top.value);
    this.height = { min: at(seen, 0.01), max: Math.max(at(seen, 0.99), at(seen, 0.01) + 0.2) };
    this.brightness = { min: at(bright, 0.02), max: at(bright, 0.98) };
    for (const group of [this.grid.group, this.rooms.group, this.zones.group, this.plan.group]) group.position.z = this.floor;
    this.recolour();
  }

  /** Whether there are points overhead at a fifth of the way, by squares of a metre. */
  private isRoofed(): boolean {
    const key = (x: number, y: number): string => `${Math.floor(x)},${Math.floor(y)}`;
    const way = new Set(this.data.trajectory.map(pose => key(pose.t_map_base?.translation?.x ?? 0, pose.t_map_base?.translation?.y ?? 0)));
    const covered = new Set<string>();
    for (const { positions } of this.cloud.parts.values()) for (let i = 0; i < positions.length; i += 3) {
      if (positions[i + 2]! > this.floor + CUT_M) covered.add(key(positions[i]!, positions[i + 1]!));
    }
    return way.size > 0 && [...way].filter(place => covered.has(place)).length > way.size / 5;
  }

  /** What the points can be coloured by; the first is what they are coloured by until somebody chooses. */
  channels(): ColourBy[] {
    const all: ColourBy[] = [];
    if (this.cloud.hasOwn) all.push('own');
    if (this.cloud.hasBrightness) all.push('reflectance');
    if (this.height.max - this.height.min > 0.25) all.push('height');
    all.push('robot');
    if (this.data.things.size) all.push('class');
    if (this.data.trajectory.length > 1) all.push('time');
    return all;
  }

  colouredBy(): ColourBy {
    const there = this.channels(), { colourBy } = this.settings;
    return colourBy && there.includes(colourBy) ? colourBy : there[0]!;
  }

  private shades(): Shades {
    const by = this.colouredBy();
    const dark = matchMedia('(prefers-color-scheme: dark)').matches;
    return { by, height: this.height, brightness: this.brightness, robot: this.rgb, dark, things: [...this.data.things.values()], times: this.times };
  }

  recolour(): void {
    const box = this.cloud.body();
    this.times = this.settings.colourBy === 'time' && this.data.trajectory.length > 1 && !box.isEmpty() ? new PassTimes(this.data.trajectory, box) : null;
    this.cloud.recolour();
  }

  private eye(): Vector3 { return this.group.worldToLocal(this.stage.camera.position.clone()); }

  /** What of it is worth looking at, in the common frame. */
  box(): Box3 {
    const box = this.cloud.body();
    for (const pose of this.data.trajectory) box.expandByPoint(translation(pose.t_map_base));
    const placed = this.placed();
    if (placed) box.expandByPoint(placed.position.clone().addScalar(0.5)).expandByPoint(placed.position.clone().addScalar(-0.5));
    this.group.updateMatrixWorld();
    return box.isEmpty() ? box : box.applyMatrix4(this.group.matrixWorld);
  }

  resize(): void { this.robot.resize(); this.keyframes.resize(); this.plan.resize(); }

  dispose(): void {
    for (const part of [this.cloud, this.trajectory, this.loops, this.things, this.rooms, this.zones, this.plan]) part.dispose();
    this.grid.clear();
    this.group.removeFromParent();
    this.stage.draw();
  }
}

/** The height below the robot at which most points lie; a planar lidar's points lie at its own height, and its floor is the robot's. */
function floorOf(sorted: number[], robot: number): number {
  if (!sorted.length || sorted.at(-1)! - sorted[0]! < 0.25) return 0;
  const bins = new Map<number, number>();
  for (const z of sorted) if (z < robot + 0.25 && z > robot - 4) { const bin = Math.round(z / 0.1); bins.set(bin, (bins.get(bin) ?? 0) + 1); }
  let best = 0, most = 0;
  for (const [bin, n] of bins) if (n > most) { most = n; best = bin; }
  return most > sorted.length * 0.02 ? best * 0.1 : robot;
}
