/** All shown sessions in one picture: where they lie, how many points each draws, what is followed. */
import { Box3, Vector3 } from 'three';
import { Emitter } from './emitter';
import { contains, translation } from './geometry';
import { Labels, type Label } from './labels';
import type { Settings } from './settings';
import type { Stage } from './stage';
import type { Fleet } from './state/fleet';
import { classColour, SESSION_COLOURS } from './colours';
import type { Room } from './types';
import { View } from './view';
import { word } from './words';

const GAP_M = 2;

export class Viewer extends Emitter<{ views: void; problem: string }> {
  views: View[] = [];
  /** The view that panels are about. */
  chosen: View | null = null;
  /** When the first points were drawn, milliseconds after the page began. */
  firstPicture_ms: number | null = null;
  private followed: Vector3 | null = null;
  private framed = false;

  constructor(readonly stage: Stage, readonly settings: Settings, private fleet: Fleet) {
    super();
    fleet.on('chosen', () => this.sync());
    settings.on('changed', () => { for (const view of this.views) view.apply(); this.lay(); });
    settings.on('time', () => { for (const view of this.views) view.refresh('way'); });
    const labels = new Labels(stage);
    labels.source = () => settings.layers.labels ? this.views.flatMap(view => this.labelsOf(view)) : [];
    stage.beforeFrame.add(moving => this.prepare(moving));
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
      for (const view of this.views) { view.recolour(); view.grid.paint(); }
    });
  }

  private sync(): void {
    const kept = new Map(this.views.map(view => [view.data.id, view]));
    const ids = new Set(this.fleet.chosen.map(data => data.id));
    for (const [id, view] of kept) if (!ids.has(id)) view.dispose();
    const used = new Set([...kept].filter(([id]) => ids.has(id)).map(([, view]) => view.colour));
    this.views = this.fleet.chosen.map(data => {
      const old = kept.get(data.id);
      if (old && old.data === data) return old;
      const colour = SESSION_COLOURS.find(each => !used.has(each)) ?? SESSION_COLOURS[used.size % SESSION_COLOURS.length]!;
      used.add(colour);
      const view = new View(data, colour, this.stage, this.settings, text => this.tell('problem', text), () => this.loaded());
      this.stage.scene.add(view.group);
      data.on('pose', () => this.follow());
      return view;
    });
    if (!this.chosen || !this.views.includes(this.chosen)) this.chosen = this.views[0] ?? null;
    this.framed = false;
    this.lay();
    this.tell('views', undefined);
  }

  choose(view: View): void { this.chosen = view; this.tell('views', undefined); }

  /** A view has its first points. */
  private loaded(): void {
    this.lay();
    if (!this.framed) this.frame();
    this.framed = this.views.every(view => view.cloud.count > 0);
    // What the points can be coloured by is known now.
    this.settings.tell('changed', undefined);
    if (this.firstPicture_ms === null) {
      const drawn = (): void => { this.stage.afterFrame.delete(drawn); this.firstPicture_ms ??= performance.now(); };
      this.stage.afterFrame.add(drawn);
    }
  }

  /** Side by side along x, or all origins in one place. */
  private lay(): void {
    let edge: number | null = null, middle = 0;
    for (const view of this.views) {
      view.group.position.set(0, 0, 0);
      if (this.settings.apart && this.views.length > 1) {
        const box = view.box();
        if (!box.isEmpty()) {
          const y = (box.min.y + box.max.y) / 2;
          if (edge === null) middle = y; else view.group.position.set(edge + GAP_M - box.min.x, middle - y, 0);
          edge = view.group.position.x + box.max.x;
        }
      }
      view.group.updateMatrixWorld();
    }
    this.stage.draw();
  }

  frame(fromAbove = false): void {
    const box = this.views.reduce((all, view) => all.union(view.box()), new Box3());
    this.stage.frameBox(box, fromAbove);
  }

  private follow(): void {
    const placed = this.settings.follow ? this.chosen?.placed() : null;
    if (!placed || !this.chosen) { this.followed = null; return; }
    const at = this.chosen.group.localToWorld(placed.position.clone());
    this.stage.shift(at.clone().sub(this.followed ?? this.stage.controls.target));
    this.followed = at;
  }

  private prepare(moving: boolean): void {
    this.follow();
    const prepared = this.views.filter(view => view.cloud.group.visible).map(view => view.cloud.prepare());
    const wanted = prepared.reduce((sum, each) => sum + each.wanted, 0);
    const share = Math.min(1, this.settings.budget / Math.max(1, wanted)) * (moving ? this.stage.share : 1);
    for (const each of prepared) each.apply(share);
    for (const view of this.views) view.resize();
  }

  /** Flies to a place of a view, near enough to see something of this size. */
  flyTo(view: View, place: Vector3, size_m: number): void {
    const at = view.group.localToWorld(place.clone());
    const away = this.stage.camera.position.clone().sub(this.stage.controls.target).normalize();
    away.z = Math.max(0.55, away.z);
    this.stage.flyTo(at, at.clone().addScaledVector(away.normalize(), Math.max(2.5, 3.5 * size_m)));
  }

  roomAt(view: View, x: number, y: number): Room | undefined {
    return view.data.rooms.rooms.find(room => contains(room.outline, x, y));
  }

  private labelsOf(view: View): Label[] {
    const { layers } = this.settings;
    const world = (place: Vector3): Vector3 => view.group.localToWorld(place);
    const id = view.data.id, labels: Label[] = [];
    if (layers.things) for (const thing of view.things.shown) {
      const place = translation(thing.box?.t_frame_box);
      place.z += (thing.box?.size_m?.z ?? 0) / 2;
      const chosen = view.chosenThing === thing.object_id;
      labels.push({ key: `${id}/t/${thing.object_id}`, text: thing.label, place: world(place), colour: classColour(thing.label), importance: chosen ? 8 : 1 + thing.confidence, kind: 'thing' });
    }
    if (layers.rooms) for (const room of view.data.rooms.rooms) {
      const text = `${roomName(room)} · ${room.area_m2.toFixed(0)} m²`;
      labels.push({ key: `${id}/r/${room.room_id}`, text, place: world(new Vector3(room.center?.x ?? 0, room.center?.y ?? 0, view.floor)), colour: '#7d8896', importance: 4, kind: 'room' });
    }
    if (layers.zones) for (const [i, zone] of (view.data.session?.zones ?? []).entries()) {
      const corner = zone.polygon[0];
      if (!corner) continue;
      const kind = zone.keep_out ? 'keep out' : `at most ${Math.round(100 * (zone.speed_share ?? 1))} % speed`;
      labels.push({ key: `${id}/z/${i}`, text: zone.name ? `${zone.name} · ${kind}` : kind, place: world(new Vector3(corner.x, corner.y, view.floor)), colour: zone.keep_out ? '#d8433b' : '#e0a020', importance: 5, kind: 'zone' });
    }
    const plan = view.plan.label;
    if (plan) labels.push({ key: `${id}/plan`, text: plan.text, place: world(plan.place.clone().setZ(view.floor + plan.place.z)), colour: plan.colour, importance: 10, kind: 'path' });
    if (layers.robot && view.robot.group.visible) {
      const name = view.data.session?.display_name || id;
      labels.push({ key: `${id}/robot`, text: name, place: view.robot.group.getWorldPosition(new Vector3()).add(new Vector3(0, 0, 0.5)), colour: view.colour, importance: 9, kind: 'robot' });
    }
    return labels;
  }
}

export const roomName = (room: Room): string => room.name || room.likely_use || word(room.kind);
