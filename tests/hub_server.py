"""A stand-in of the Hugging Face hub: the part of its HTTP API that huggingface-hub asks for here.

Repositories with commits of whole file trees; large files by the LFS batch API, behind a redirect.
"""

import base64
import hashlib
import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import unquote, urlsplit

TOKEN = "hf_StandInSecretToken"
LARGE = (".safetensors", ".png")
TYPES = {"": "model", "datasets/": "dataset"}


@dataclass
class Repository:
    private: bool
    trees: dict[str, dict[str, bytes]] = field(default_factory=dict)
    """Files of each commit, the newest last."""

    @property
    def newest(self) -> str:
        return list(self.trees)[-1]

    def commit(self, tree: dict[str, bytes]) -> str:
        oid = hashlib.sha1(f"{len(self.trees)}".encode() + repr(sorted(tree)).encode()).hexdigest()
        self.trees[oid] = tree
        return oid

    def find(self, revision: str) -> str | None:
        return self.newest if revision == "main" else revision if revision in self.trees else None


@dataclass
class StandIn:
    """What the server knows, and what it was asked."""

    repositories: dict[tuple[str, str], Repository] = field(default_factory=dict)
    large: dict[str, bytes] = field(default_factory=dict)
    """By SHA-256."""
    asked: list[str] = field(default_factory=list)
    """Methods and paths."""
    url: str = ""

    @property
    def storage(self) -> str:
        """Where large files lie: on another host, as with the hub."""
        return self.url.replace("127.0.0.1", "localhost")

    def made(self, name: str, tree: dict[str, bytes], kind: str = "model") -> Repository:
        """A repository with one commit, put there by hand."""
        repository = self.repositories[kind, name] = Repository(private=False)
        repository.commit(tree)
        return repository


@contextmanager
def running_hub() -> Iterator[StandIn]:
    hub = StandIn()

    class Handler(_Handler):
        known = hub

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    hub.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield hub
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Handler(BaseHTTPRequestHandler):
    known: StandIn
    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *values: object) -> None:
        pass

    def do_HEAD(self) -> None:
        self._read()

    def do_GET(self) -> None:
        self._read()

    def do_PUT(self) -> None:
        body, digest = self._body(), self.path.removeprefix("/lfs/")
        if hashlib.sha256(body).hexdigest() != digest:
            return self._say(400, {"error": "another SHA-256"})
        self.known.large[digest] = body
        return self._say(200)

    def do_POST(self) -> None:
        body, path = self._body(), urlsplit(self.path).path
        if self.headers.get("Authorization") != f"Bearer {TOKEN}":
            return self._say(401, {"error": "Invalid username or password."})
        if path == "/api/validate-yaml":
            return self._say(200, {})
        if path == "/lfs/verify":
            return self._say(200 if json.loads(body)["oid"] in self.known.large else 404)
        if path == "/api/repos/create":
            return self._create(json.loads(body))
        if found := re.fullmatch("/(datasets/)?([^/]+/[^/]+)[.]git/info/lfs/objects/batch", path):
            return self._batch(json.loads(body))
        found = re.fullmatch("/api/(model|dataset)s/([^/]+/[^/]+)/(preupload|commit)/main", path)
        repository = self.known.repositories.get((found[1], found[2])) if found else None
        if found is None or repository is None:
            return self._missing("RepoNotFound")
        if found[3] == "preupload":
            return self._preupload(json.loads(body))
        return self._commit(found[2], repository, [json.loads(line) for line in body.splitlines()])

    def _read(self) -> None:
        self.known.asked.append(f"{self.command} {self.path}")
        path = unquote(urlsplit(self.path).path)
        if path.startswith("/lfs/"):
            return self._send(self.known.large[path.removeprefix("/lfs/")])
        if found := re.fullmatch("/api/(model|dataset)s/([^/]+/[^/]+)(?:/revision/(.+))?", path):
            return self._info(found[1], found[2], found[3] or "main")
        found = re.fullmatch("/(datasets/)?([^/]+/[^/]+)/resolve/([^/]+)/(.+)", path)
        if not found:
            return self._say(404)
        repository = self._visible(TYPES[found[1] or ""], found[2])
        commit = repository.find(found[3]) if repository else None
        if repository is None or commit is None:
            return self._missing("RevisionNotFound" if repository else "RepoNotFound")
        content = repository.trees[commit].get(found[4])
        if content is None:
            return self._missing("EntryNotFound", {"X-Repo-Commit": commit})
        digest = hashlib.sha256(content).hexdigest()
        if found[4].endswith(LARGE):
            self.known.large.setdefault(digest, content)
            return self._say(
                302,
                headers={
                    "Location": f"{self.known.storage}/lfs/{digest}", "X-Repo-Commit": commit,
                    "X-Linked-Etag": f'"{digest}"', "X-Linked-Size": str(len(content)),
                },
            )  # fmt: skip
        etag = hashlib.sha1(content).hexdigest()
        return self._send(content, {"ETag": f'"{etag}"', "X-Repo-Commit": commit})

    def _visible(self, kind: str, name: str) -> Repository | None:
        repository = self.known.repositories.get((kind, name))
        may = self.headers.get("Authorization") == f"Bearer {TOKEN}"
        return repository if repository and (may or not repository.private) else None

    def _info(self, kind: str, name: str, revision: str) -> None:
        repository = self._visible(kind, name)
        if repository is None:
            return self._missing("RepoNotFound")
        commit = repository.find(revision)
        if commit is None:
            return self._missing("RevisionNotFound")
        files = [{"rfilename": file} for file in repository.trees[commit]]
        return self._say(200, {"id": name, "sha": commit, "private": repository.private,
                               "tags": [], "siblings": files})  # fmt: skip

    def _create(self, asked: dict[str, Any]) -> None:
        name = f"{asked['organization']}/{asked['name']}"
        if asked["organization"] != "ada":
            return self._say(403, {"error": "You don't have the rights to create it."})
        key = (asked.get("type") or "model", name)
        if key in self.known.repositories:
            return self._say(409, {"error": "it exists", "url": f"{self.known.url}/{name}"})
        private = asked.get("visibility") == "private" or bool(asked.get("private"))
        repository = self.known.repositories[key] = Repository(private)
        repository.commit({".gitattributes": b"*.safetensors filter=lfs\n"})
        return self._say(200, {"url": f"{self.known.url}/{name}"})

    def _preupload(self, asked: dict[str, Any]) -> None:
        files = [
            {
                "path": each["path"], "shouldIgnore": False,
                "uploadMode": "lfs" if each["path"].endswith(LARGE) else "regular",
            }
            for each in asked["files"]
        ]  # fmt: skip
        self._say(200, {"files": files})

    def _batch(self, asked: dict[str, Any]) -> None:
        verify = {"href": f"{self.known.url}/lfs/verify"}
        objects = [
            {**each, "actions": {"upload": {"href": f"{self.known.url}/lfs/{each['oid']}"},
                                 "verify": verify}}
            for each in asked["objects"]
        ]  # fmt: skip
        self._say(200, {"transfer": "basic", "objects": objects})

    def _commit(self, name: str, repository: Repository, lines: list[dict[str, Any]]) -> None:
        tree = dict(repository.trees[repository.newest])
        for line in lines:
            value = line["value"]
            if line["key"] == "header" and value.get("parentCommit") != repository.newest:
                return self._say(412, {"error": "the branch has moved"})
            if line["key"] == "file":
                tree[value["path"]] = base64.b64decode(value["content"])
            elif line["key"] == "lfsFile":
                tree[value["path"]] = self.known.large[value["oid"]]
            elif line["key"] == "deletedFile":
                del tree[value["path"]]
        oid = repository.commit(tree)
        url = f"{self.known.url}/{name}/commit/{oid}"
        return self._say(200, {"commitOid": oid, "commitUrl": url})

    def _body(self) -> bytes:
        self.known.asked.append(f"{self.command} {self.path}")
        return self.rfile.read(int(self.headers.get("Content-Length", 0)))

    def _missing(self, code: str, headers: dict[str, str] | None = None) -> None:
        # The hub says 401 of a repository to whoever is not logged in.
        status = 401 if code == "RepoNotFound" and not self.headers.get("Authorization") else 404
        self._say(status, {"error": code}, {"X-Error-Code": code, **(headers or {})})

    def _say(
        self, status: int, value: object = None, headers: dict[str, str] | None = None
    ) -> None:
        content = b"" if value is None else json.dumps(value).encode()
        self._send(content, {"Content-Type": "application/json", **(headers or {})}, status)

    def _send(
        self, content: bytes, headers: dict[str, str] | None = None, status: int = 200
    ) -> None:
        self.send_response(status)
        for name, value in {**(headers or {}), "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)
