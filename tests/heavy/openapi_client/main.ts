// Asks a server through a client that was generated from its own OpenAPI document: node main.js http://127.0.0.1:8080
import createClient from "openapi-fetch";
import type { components, paths } from "./api.js";

type Cloud = components["schemas"]["PointCloud"];

const client = createClient<paths>({ baseUrl: process.argv[2] });

function check(what: string, holds: boolean): void {
  if (!holds) throw new Error(`not so: ${what}`);
}

function floats(values: number[]): string {
  return Buffer.from(new Float32Array(values).buffer).toString("base64");
}

async function main(): Promise<void> {
  const made = await client.POST("/v1/sessions", { body: { session_id: "by-typescript" } });
  check("a session is created", made.data?.session?.session_id === "by-typescript");
  const again = await client.POST("/v1/sessions", { body: { session_id: "by-typescript" } });
  check("a problem has its reason", again.error?.reason === "SESSION_EXISTS");

  const path = { session_id: "by-typescript" };
  const listed = await client.GET("/v1/sessions", { params: { query: { page_size: 10 } } });
  check("sessions are listed", listed.data?.sessions.some((s) => s.session_id === path.session_id) === true);
  const graph = await client.GET("/v1/sessions/{session_id}/scene-graph", { params: { path } });
  // It may be Graphviz's language, which is text.
  const nodes = typeof graph.data === "object" ? graph.data.graph?.nodes : undefined;
  check("the graph has its nodes", Array.isArray(nodes));

  const cloud: Cloud = { num_points: 4, positions: floats([0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1]) };
  const hull = await client.POST("/v1/toolbox/compute-convex-hull", { body: { cloud: { cloud } } });
  check("a tetrahedron's volume is a sixth", Math.abs((hull.data?.volume_m3 ?? 0) - 1 / 6) < 1e-6);
  const none = await client.POST("/v1/toolbox/compute-convex-hull", { body: { cloud: { handle: "none" } } });
  check("a handle that is not kept is named", none.error?.field === "cloud.handle");

  const gone = await client.DELETE("/v1/sessions/{session_id}", { params: { path } });
  check("a session is deleted", gone.error === undefined);
}

await main();
