/** Reads the fields of a protobuf message, without a schema: enough for the few large answers. */

export type Fields = (field: number, value: number, bytes: Uint8Array) => void;

/** Calls `each` for every field: with a number, or with the bytes of text, bytes and messages. */
export function walk(message: Uint8Array, each: Fields): void {
  const view = new DataView(message.buffer, message.byteOffset, message.byteLength);
  const none = new Uint8Array();
  let at = 0;
  const varint = (): number => {
    let value = 0;
    for (let scale = 1; ; scale *= 128) {
      const byte = message[at++];
      if (byte === undefined) throw new RangeError('the message is cut');
      value += (byte & 127) * scale;
      if (byte < 128) return value;
    }
  };
  while (at < message.length) {
    const tag = varint();
    const field = Math.floor(tag / 8);
    switch (tag & 7) {
      case 0: each(field, varint(), none); break;
      case 1: each(field, view.getFloat64(at, true), none); at += 8; break;
      case 2: {
        const length = varint();
        if (at + length > message.length) throw new RangeError('the message is cut');
        each(field, length, message.subarray(at, at + length));
        at += length;
        break;
      }
      case 5: each(field, view.getFloat32(at, true), none); at += 4; break;
      default: throw new RangeError(`wire type ${tag & 7} is unknown`);
    }
  }
}

/** Little-endian floats; copied, as they need not lie at a multiple of four. */
export const floats = (bytes: Uint8Array): Float32Array =>
  new Float32Array(bytes.slice().buffer, 0, bytes.length >> 2);

export const integers = (bytes: Uint8Array): Uint32Array =>
  new Uint32Array(bytes.slice().buffer, 0, bytes.length >> 2);

/** Parts of a field that comes again and again, as one. */
export function joined(parts: Uint8Array[]): Uint8Array {
  if (parts.length === 1) return parts[0]!;
  const all = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) { all.set(part, at); at += part.length; }
  return all;
}

/** sint32's zigzag. */
export const signed = (value: number): number => value % 2 ? -(value + 1) / 2 : value / 2;
