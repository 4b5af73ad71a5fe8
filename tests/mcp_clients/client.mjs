// SPDX-License-Identifier: Apache-2.0
// The Model Context Protocol's own client for JavaScript against `python -m lithe.mcp`: over stdio with the words
// {"command", "args", "env"}, over HTTP with {"url", "token"}, as JSON in argv[2]. It does what argv[3], a JSON list of
// [tool, arguments], says, and prints one JSON line: the version, tools, resources, prompts, what each call answered and
// how large each picture is. It lies beside node_modules when it runs.
import { Client } from "@modelcontextprotocol/sdk/client/index.js";
import { StdioClientTransport } from "@modelcontextprotocol/sdk/client/stdio.js";
import { StreamableHTTPClientTransport } from "@modelcontextprotocol/sdk/client/streamableHttp.js";

const way = JSON.parse(process.argv[2]);
const calls = JSON.parse(process.argv[3]);
const transport = way.url
  ? new StreamableHTTPClientTransport(new URL(way.url), { requestInit: { headers: { Authorization: `Bearer ${way.token}` } } })
  : new StdioClientTransport(way);
const client = new Client({ name: "lithe-test", version: "1" });
let version;
const keep = transport.setProtocolVersion?.bind(transport);
transport.setProtocolVersion = (agreed) => { version = agreed; keep?.(agreed); };
await client.connect(transport);
const said = {
  tools: (await client.listTools()).tools.map((tool) => tool.name),
  resources: (await client.listResources()).resources.map((resource) => resource.uri),
  templates: (await client.listResourceTemplates()).resourceTemplates.map((template) => template.uriTemplate),
  prompts: (await client.listPrompts()).prompts.map((prompt) => prompt.name),
  contract: (await client.readResource({ uri: "lithe://contract" })).contents[0].text.length,
  version,
  answers: [],
  pictures: {},
};
for (const [name, args] of calls) {
  const answer = await client.callTool({ name, arguments: args }, undefined, { timeout: 120000 });
  said.answers.push({ error: answer.isError === true, text: answer.content[0].text });
}
for (const uri of said.resources.filter((each) => each.endsWith(".png"))) {
  const [told] = await client.readResource({ uri }).then((read) => read.contents, (error) => [{ blob: "", error }]);
  said.pictures[uri] = told.error ? String(told.error) : `${Buffer.from(told.blob, "base64").length} bytes`;
}
await client.close();
console.log(JSON.stringify(said));
