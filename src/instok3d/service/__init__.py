"""Scenes for other programs: an HTTP API and the same tools over MCP; needs the extra `serve`."""
