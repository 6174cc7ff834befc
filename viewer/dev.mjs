// Serves the page, built anew for each reload, and hands all else to a percept server:
//   npm run dev -- [server, default http://127.0.0.1:8080] [port, default 5173]
import { createServer, request } from 'node:http';
import { page } from './build.mjs';

const server = new URL(process.argv[2] ?? 'http://127.0.0.1:8080');
const port = Number(process.argv[3] ?? 5173);
// As the server has it, so that what it would block is blocked here.
const policy = "default-src 'none'; connect-src 'self'; img-src 'self' blob: data:; style-src 'unsafe-inline'; "
  + "script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

createServer(async (from, to) => {
  if (from.url === '/') {
    try {
      const text = await page();
      to.writeHead(200, { 'content-type': 'text/html; charset=utf-8', 'cache-control': 'no-store', 'content-security-policy': policy });
      to.end(text);
    } catch (e) {
      to.writeHead(500, { 'content-type': 'text/plain; charset=utf-8' });
      to.end(String(e));
    }
    return;
  }
  // The server lets no page of another origin change anything; this one stands for its own.
  const headers = { ...from.headers, host: server.host, ...(from.headers.origin && { origin: server.origin }) };
  const onward = request(new URL(from.url, server), { method: from.method, headers }, answer => {
    to.writeHead(answer.statusCode, answer.headers);
    // Events wait for nothing, their headers neither.
    to.flushHeaders();
    answer.pipe(to);
  });
  onward.on('error', () => to.destroy());
  to.on('close', () => onward.destroy());
  from.pipe(onward);
}).listen(port, '127.0.0.1', () => console.log(`http://127.0.0.1:${port} shows ${server.href}`));
