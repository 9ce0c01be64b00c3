"""The only thing of the viewer that listens: a small web server on 127.0.0.1.

It hands out the viewer's page and one stream of data, and takes nothing in: only GET is answered.
A request must carry the token of this view in its path and name this machine as its host. A web
page of another origin is refused, and on Linux another user of the machine as well, even with the
token. Everything else is answered with 403 and no content.

Connections are bounded. One without a valid request has a few seconds and a few places; when the
places are taken, the oldest goes. They are accepted at a bounded rate. So a mass of connections
costs this process little, and never the place of a viewer that is already connected.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import os
import re
import secrets
import socket
import struct
import threading
import urllib.parse
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from daq.live.page import INDEX, LOOPBACK, PageFile

DATA = "view.rrd"
MOST_STRANGERS = 64
MOST_GUESTS = 32
MOST_VIEWERS = 8
HEADER_S = 3.0
MOST_HEADER = 8192
ACCEPT_PAUSE_S = 0.002
BLOCK = 1 << 18

# The page may run its own code and read from this server; no fonts or reports from elsewhere.
POLICY = (
    "default-src 'self' blob: data:; "
    "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; worker-src 'self' blob:; "
    "connect-src 'self' blob: data:; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = (
    f"Content-Security-Policy: {POLICY}",
    "X-Content-Type-Options: nosniff",
    "X-Frame-Options: DENY",
    "Cross-Origin-Resource-Policy: same-origin",
    "Cross-Origin-Opener-Policy: same-origin",
    "Referrer-Policy: no-referrer",
    "Cache-Control: no-store",
    "Connection: close",
)
_HOST = re.compile(r"(127\.0\.0\.1|localhost)(:\d{1,5})?\Z", re.ASCII)
_WORDS = {200: "OK", 302: "Found", 403: "Forbidden", 404: "Not Found", 405: "Method Not Allowed",
          400: "Bad Request", 503: "Service Unavailable"}  # fmt: skip


class Data(Protocol):
    """What viewers read."""

    @property
    def size(self) -> int | None:
        """In bytes; None while it grows."""
        ...

    def read(self) -> AsyncIterator[bytes]:
        """The data from their beginning, and then what comes."""
        ...


@dataclass(frozen=True)
class _Request:
    method: str
    path: str
    query: str
    headers: Mapping[str, str]


class _Refused(Exception):
    def __init__(self, status: int) -> None:
        self.status = status


class Door:
    """Serves a view until ``close``.

    Args:
        data: what viewers read.
        files: of the page; empty for none.
        port: on 127.0.0.1; if it is in use, another free one.
    """

    def __init__(self, data: Data, files: Mapping[str, PageFile], port: int) -> None:
        self._data = data
        self._files = files
        self._token = secrets.token_urlsafe(32)
        self._listener = _listen(port)
        self.port = int(self._listener.getsockname()[1])
        self.url = f"http://{LOOPBACK}:{self.port}/{self._token}/"
        self.data_url = self.url + DATA
        self._strangers: dict[asyncio.StreamWriter, None] = {}
        self._guests = 0
        self.viewers = 0
        self.refused = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._work, name="door", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop serving. May be repeated."""
        if self._thread.is_alive():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(5.0)

    # ---- on the door's thread -----------------------------------------------------------

    def _work(self) -> None:
        loop = self._loop
        asyncio.set_event_loop(loop)
        accepting = loop.create_task(self._accept())
        try:
            loop.run_forever()
        finally:
            self._listener.close()
            left = [accepting, *self._tasks]
            for task in left:
                task.cancel()
            loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
            loop.run_until_complete(asyncio.sleep(0))
            loop.close()

    async def _accept(self) -> None:
        while True:
            try:
                client, _ = await self._loop.sock_accept(self._listener)
            except OSError:  # out of file descriptors, or gone again
                await asyncio.sleep(0.1)
                continue
            task = self._loop.create_task(self._serve(client))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
            await asyncio.sleep(ACCEPT_PAUSE_S)

    async def _serve(self, client: socket.socket) -> None:
        reader, writer = await asyncio.open_connection(sock=client, limit=MOST_HEADER)
        try:
            self._strangers[writer] = None
            if len(self._strangers) > MOST_STRANGERS:
                oldest = next(iter(self._strangers))
                del self._strangers[oldest]
                oldest.transport.abort()
            try:
                async with asyncio.timeout(HEADER_S):
                    request = await _request(reader)
                self._admit(request, writer)
            except _Refused as refused:
                self.refused += 1
                await _answer(writer, refused.status)
                return
            self._strangers.pop(writer, None)
            self._guests += 1
            try:
                await self._respond(request, writer)
            finally:
                self._guests -= 1
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass
        finally:
            self._strangers.pop(writer, None)
            writer.transport.abort() if writer.is_closing() else writer.close()

    def _admit(self, request: _Request, writer: asyncio.StreamWriter) -> None:
        """Refuse a request that is not the user's own browser reading this view."""
        host = request.headers.get("host", "")
        origin = request.headers.get("origin")
        site = request.headers.get("sec-fetch-site", "none")
        opens_page = request.headers.get("sec-fetch-mode") == "navigate"
        token = request.path.split("/")[1] if request.path.startswith("/") else ""
        if (
            not _HOST.match(host)
            or (origin is not None and origin != f"http://{host}")
            or (site not in ("none", "same-origin") and not opens_page)
            or not hmac.compare_digest(token.encode(), self._token.encode())
            or not _same_user(writer)
        ):
            raise _Refused(403)
        if request.method != "GET":
            raise _Refused(405)
        if "content-length" in request.headers or "transfer-encoding" in request.headers:
            raise _Refused(400)
        if self._guests >= MOST_GUESTS:
            raise _Refused(503)

    async def _respond(self, request: _Request, writer: asyncio.StreamWriter) -> None:
        name = request.path[len(self._token) + 2 :]
        if name == DATA:
            await self._stream(writer)
        elif name in ("", INDEX) and self._files:
            if "url=" not in request.query:
                here = f"http://{request.headers['host']}/{self._token}/"
                query = urllib.parse.urlencode(
                    {"url": here + DATA, "theme": "dark", "persist": "0"}
                )
                await _answer(writer, 302, [f"Location: {here}?{query}"])
                return
            await self._file(writer, self._files[INDEX])
        elif name in self._files:
            await self._file(writer, self._files[name])
        else:
            await _answer(writer, 404)

    async def _file(self, writer: asyncio.StreamWriter, file: PageFile) -> None:
        size = len(file.content)
        # The page's progress display reads the second of the two sizes.
        _head(writer, 200, [f"Content-Type: {file.media_type}", f"Content-Length: {size}",
                            f"rerun-final-length: {size}"])  # fmt: skip
        for at in range(0, size, BLOCK):
            await _write(writer, file.content[at : at + BLOCK])
        await writer.drain()

    async def _stream(self, writer: asyncio.StreamWriter) -> None:
        if self.viewers >= MOST_VIEWERS:
            await _answer(writer, 503)
            return
        size = self._data.size
        extra = [] if size is None else [f"Content-Length: {size}"]
        _head(writer, 200, ["Content-Type: application/octet-stream", *extra])
        self.viewers += 1
        try:
            async for block in self._data.read():
                if writer.is_closing():
                    return
                await _write(writer, block)
            await writer.drain()
            writer.write_eof()
        finally:
            self.viewers -= 1


def _listen(port: int) -> socket.socket:
    for wanted in (port, 0):
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if os.name == "posix":  # on Windows it would let two programs share the port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((LOOPBACK, wanted))
        except OSError:
            listener.close()
            if wanted == 0:
                raise
            continue
        listener.listen(128)
        listener.setblocking(False)
        return listener
    raise AssertionError("unreachable")


async def _request(reader: asyncio.StreamReader) -> _Request:
    """The head of a request.

    Raises:
        _Refused: it is not one.
    """
    text = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1")
    first, *lines = text[:-4].split("\r\n")
    words = first.split(" ")
    if len(words) != 3 or not words[2].startswith("HTTP/1."):
        raise _Refused(400)
    headers: dict[str, str] = {}
    for line in lines:
        name, colon, value = line.partition(":")
        if not colon or name.lower() in headers:
            raise _Refused(400)
        headers[name.lower()] = value.strip()
    path, _, query = words[1].partition("?")
    return _Request(words[0], path, query, headers)


def _head(writer: asyncio.StreamWriter, status: int, lines: list[str]) -> None:
    head = [f"HTTP/1.1 {status} {_WORDS[status]}", *_HEADERS, *lines, "", ""]
    writer.write("\r\n".join(head).encode("latin-1"))


async def _answer(
    writer: asyncio.StreamWriter, status: int, lines: list[str] | None = None
) -> None:
    _head(writer, status, [*(lines or []), "Content-Length: 0"])
    async with asyncio.timeout(HEADER_S):
        await writer.drain()


async def _write(writer: asyncio.StreamWriter, block: bytes) -> None:
    """Write a block and wait until most of it is on its way: slow readers get no buffer."""
    writer.write(block)
    await writer.drain()


def _same_user(writer: asyncio.StreamWriter) -> bool:
    """Whether the other end belongs to this user, or to the system; True where none can tell.

    A token can be seen by others for a moment, in the list of processes when a browser is opened.
    Linux says whose the other end of a local connection is.
    """
    peer = writer.get_extra_info("peername")
    if peer is None:
        return False
    tables = [Path("/proc/net/tcp"), Path("/proc/net/tcp6")]
    if not tables[0].exists():
        return True
    address = struct.unpack("=I", socket.inet_aton(peer[0]))[0]
    local = f"{address:08X}:{peer[1]:04X}"
    remote = f":{writer.get_extra_info('sockname')[1]:04X}"
    for table in tables:
        with contextlib.suppress(OSError):
            for line in table.read_text().splitlines()[1:]:
                fields = line.split()
                if fields[1].endswith(local) and fields[2].endswith(remote):
                    return int(fields[7]) in (os.getuid(), 0)
    return False
