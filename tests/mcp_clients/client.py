# SPDX-License-Identifier: Apache-2.0
"""The Model Context Protocol's own client for Python against `python -m lithe.mcp`; words and answer as client.mjs has.

{"mode"}: "legacy" begins with a handshake, "auto" asks for the newest version first. The SDK checks every answer
against its types; what it does not check, the schemas of the tools, is checked here.
"""

import asyncio
import base64
import json
import sys
from typing import Any

from jsonschema import Draft202012Validator
from mcp import Client, MCPError, StdioServerParameters
from mcp.client.streamable_http import streamable_http_client
from mcp.shared._httpx_utils import create_mcp_http_client

PNG = b"\x89PNG\r\n\x1a\n"


async def picture(client: Client, uri: str) -> str:
    """Its size, or why there is none."""
    try:
        (told,) = (await client.read_resource(uri)).contents
    except MCPError as error:
        return str(error)
    data = base64.b64decode(told.blob)
    assert told.mime_type == "image/png" and data.startswith(PNG), told
    return f"{len(data)} bytes"


async def listed(client: Client) -> dict[str, Any]:
    """What the server has; every schema is one, every text and prompt can be read."""
    tools = (await client.list_tools()).tools
    for tool in tools:
        Draft202012Validator.check_schema(tool.input_schema)
    resources = (await client.list_resources()).resources
    texts = [each for each in resources if each.mime_type != "image/png"]
    for each in texts:
        (told,) = (await client.read_resource(each.uri)).contents
        assert told.mime_type == each.mime_type and told.text, each
    prompts = (await client.list_prompts()).prompts
    for prompt in prompts:
        (message,) = (await client.get_prompt(prompt.name, {"about": "joint 2"})).messages
        assert message.content.text.endswith("joint 2"), prompt
    return {
        "version": client.protocol_version,
        "tools": [each.name for each in tools],
        "resources": [each.uri for each in resources],
        "templates": [each.uri_template for each in (await client.list_resource_templates()).resource_templates],
        "prompts": [each.name for each in prompts],
        "contract": len((await client.read_resource("lithe://contract")).contents[0].text),
    }


async def main(way: dict[str, Any], calls: list[tuple[str, dict[str, Any]]]) -> dict[str, Any]:
    """Does what it was told."""
    server: Any
    if "url" in way:
        http = create_mcp_http_client(headers={"Authorization": f"Bearer {way['token']}"})
        server = streamable_http_client(way["url"], http_client=http)
    else:
        server = StdioServerParameters(command=way["command"], args=way["args"], env=way["env"])
    async with Client(server, mode=way["mode"], cache=None) as client:
        said = await listed(client)
        answers = [await client.call_tool(name, args, read_timeout_seconds=120) for name, args in calls]
        said["answers"] = [{"error": each.is_error, "text": each.content[0].text} for each in answers]
        pictures = [uri for uri in said["resources"] if uri.endswith(".png")]
        said["pictures"] = {uri: await picture(client, uri) for uri in pictures}
        return said


if __name__ == "__main__":
    print(json.dumps(asyncio.run(main(json.loads(sys.argv[1]), json.loads(sys.argv[2])))))
