/** What is known of one chosen session: read once, then kept up to date by events. */
import { connection, of, query, read, readAll, wordsOf } from '../api';
import { Emitter } from '../emitter';
import type { FleetEvent, Keyframe, Loop, PoseEstimate, Rooms, Session, Thing, TrajectoryPose } from '../types';
import { word } from '../words';

/** Poses of a trajectory that are drawn; a longer one comes at even distances. */
const MAX_POSES = 6000;
/** Keyframes move a little with every correction; where they are is read anew no more often. */
const CORRECTED_MS = 4000;
const LOG_LENGTH = 200;

export interface LogLine { token: string; stamp_ns: string; text: string; kind: 'keyframe' | 'object' | 'loop' | 'life' | 'pose' }

type Changes = {
  session: Session; pose: PoseEstimate; trajectory: void; keyframes: void; loops: void; things: void;
  rooms: void; map: string; log: void; problem: string;
};

export class SessionData extends Emitter<Changes> {
  session: Session | null = null;
  pose: PoseEstimate | null = null;
  trajectory: TrajectoryPose[] = [];
  keyframes = new Map<string, Keyframe>();
  loops = new Map<string, Loop>();
  things = new Map<string, Thing>();
  rooms: Rooms = { rooms: [], doors: [], map_version: '0' };
  log: LogLine[] = [];
  private stop = new AbortController();
  private correctedAt = 0;
  private roomsAt = 0;
  private sessionAt = 0;
  private stale = { path: false, rooms: false, session: false };
  private busy = new Set<string>();

  constructor(readonly id: string) {
    super();
    // What only comes by asking, no more often than is looked at.
    const timer = window.setInterval(() => void this.tick(), 500);
    this.stop.signal.addEventListener('abort', () => clearInterval(timer));
  }

  get signal(): AbortSignal { return this.stop.signal; }
  dispose(): void { this.stop.abort(); }

  /** Reads everything; also after events were lost. */
  async load(): Promise<void> {
    await this.readSession();
    if (!this.session) return;
    await Promise.all([this.readPath(), this.readThings(), this.readRooms()]);
  }

  /** One question at a time of each kind; what is wrong is told, and not thrown. */
  private async once(name: string, question: () => Promise<void>): Promise<void> {
    if (this.busy.has(name) || this.signal.aborted) return;
    this.busy.add(name);
    try { await question(); } catch (e) {
      if (!this.signal.aborted && !(e instanceof TypeError)) this.tell('problem', wordsOf(e));
    } finally { this.busy.delete(name); }
  }

  readSession = (): Promise<void> => this.once('session', async () => {
    const { session } = await read<{ session: Session }>(of(this.id), this.signal);
    this.session = session;
    this.sessionAt = performance.now();
    this.tell('session', session);
    if (session.pose) { this.pose = session.pose; this.tell('pose', session.pose); }
  });

  private readPath = (): Promise<void> => this.once('path', async () => {
    this.stale.path = false;
    this.correctedAt = performance.now();
    const [way, keyframes, loops] = await Promise.all([
      read<{ poses: TrajectoryPose[] }>(of(this.id, '/trajectory' + query({ max_poses: MAX_POSES })), this.signal),
      readAll<Keyframe>(of(this.id, '/keyframes'), 'keyframes', this.signal),
      readAll<Loop>(of(this.id, '/map/loops'), 'loops', this.signal),
    ]);
    this.trajectory = way.poses;
    this.keyframes = new Map(keyframes.map(k => [k.keyframe_id, k]));
    this.loops = new Map(loops.map(l => [l.loop_id, l]));
    this.tell('trajectory', undefined);
    this.tell('keyframes', undefined);
    this.tell('loops', undefined);
  });

  private readThings = (): Promise<void> => this.once('things', async () => {
    const things = await readAll<Thing>(of(this.id, '/objects'), 'objects', this.signal);
    this.things = new Map(things.map(t => [t.object_id, t]));
    this.tell('things', undefined);
  });

  private readRooms = (): Promise<void> => this.once('rooms', async () => {
    this.stale.rooms = false;
    this.roomsAt = performance.now();
    const rooms = await read<Rooms>(of(this.id, '/rooms'), this.signal);
    this.rooms = { rooms: rooms.rooms ?? [], doors: rooms.doors ?? [], map_version: rooms.map_version };
    this.tell('rooms', undefined);
  });

  private async tick(): Promise<void> {
    if (connection.link !== 'up' || document.hidden) return;
    const now = performance.now();
    if (this.stale.session && now - this.sessionAt > 2000) { this.stale.session = false; await this.readSession(); }
    if (this.stale.path && now - this.correctedAt > CORRECTED_MS) await this.readPath();
    if (this.stale.rooms && now - this.roomsAt > CORRECTED_MS) await this.readRooms();
  }

  /** A veto's answer, and an event's. */
  setLoop(loop: Loop): void {
    this.loops.set(loop.loop_id, loop);
    this.stale.path = true;
    this.tell('loops', undefined);
  }

  setSession(session: Session): void {
    this.session = session;
    this.tell('session', session);
  }

  take(event: FleetEvent): void {
    const note = (kind: LogLine['kind'], text: string): void => {
      this.log.unshift({ token: event.token, stamp_ns: event.stamp_ns, text, kind });
      this.log.length = Math.min(this.log.length, LOG_LENGTH);
      this.tell('log', undefined);
    };
    if (event.resync) { void this.load(); this.tell('map', ''); return; }
    if (event.pose) this.takePose(event.pose, note);
    if (event.keyframe_added) {
      const keyframe = event.keyframe_added;
      this.keyframes.set(keyframe.keyframe_id, keyframe);
      this.tell('keyframes', undefined);
      note('keyframe', `keyframe ${keyframe.keyframe_id} of ${keyframe.sensor_id}`);
    }
    if (event.object_changed) {
      const { object, object_id, kind, merged_into } = event.object_changed;
      // The list leaves out what is gone, too.
      if (object && kind !== 'OBJECT_CHANGE_KIND_GONE') this.things.set(object_id, object); else this.things.delete(object_id);
      this.tell('things', undefined);
      if (kind !== 'OBJECT_CHANGE_KIND_UPDATED') {
        note('object', `${object?.label ?? 'thing'} ${object_id} ${word(kind)}${merged_into ? ` into ${merged_into}` : ''}`);
      }
    }
    if (event.loop_changed) {
      const loop = event.loop_changed;
      this.setLoop(loop);
      note('loop', `loop ${loop.loop_id} ${word(loop.state)}: keyframe ${loop.to_keyframe_id} saw ${loop.from_keyframe_id} again`);
    }
    if (event.map_version) {
      this.stale.path = this.stale.rooms = true;
      this.tell('map', event.map_version);
    }
    if (event.life) note('life', event.life.step === 'LIFE_STEP_MOVED' ? word(event.life.state) : word(event.life.step));
    if (event.new_etag || event.life) void this.readSession();
  }

  private takePose(pose: PoseEstimate, note: (kind: LogLine['kind'], text: string) => void): void {
    if (this.pose && this.pose.state !== pose.state) {
      note('pose', `pose: ${word(pose.state)}${pose.lost_message ? `, ${pose.lost_message}` : ''}`);
    }
    this.pose = pose;
    this.stale.session = true;
    this.trajectory.push({ stamp_ns: pose.stamp_ns, t_map_base: pose.t_map_base, state: pose.state, scale: pose.scale });
    // Half of a long way tells as much; where it is by then is read anew with the next correction.
    if (this.trajectory.length > 2 * MAX_POSES) this.trajectory = this.trajectory.filter((_, i) => i % 2 === 0);
    this.tell('pose', pose);
    this.tell('trajectory', undefined);
  }
}
