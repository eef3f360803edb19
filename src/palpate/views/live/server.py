"""Server of the live view: one page and its data, on the loopback interface of this computer only."""

import asyncio
import json
import secrets
import socket
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, closing, suppress
from importlib.resources import files
from typing import Any

from palpate.base.optional_imports import import_extra
from palpate.views.live.frames import FrameStore

HOST = "127.0.0.1"
_HOST_NAMES = ("127.0.0.1", "localhost")
_PERIOD_S = 0.05
_MAX_CLIENTS = 32
"""Pages that are served at a time; more are told to come back."""

_PAGE_FILES = {"page.js": "text/javascript", "page.css": "text/css"}
_POLICY = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:"


class LiveView:
    """The page's data: frames so far, what does not change, and what the stop button does.

    `update` brings the frames up to date, on a thread of its own; `stop` is None where nothing can be.
    """

    def __init__(
        self,
        store: FrameStore,
        setting: Mapping[str, object],
        update: Callable[[], None],
        stop: Callable[[], Mapping[str, object]] | None = None,
    ) -> None:
        self.store = store
        self.setting = setting
        self.update = update
        self.stop = stop
        self.token = secrets.token_urlsafe(24)
        self.skipped = 0
        """Frames that a page was too slow to be sent, over all pages."""
        self.pages = 0


class _Pages:
    """Answers to requests, as Starlette's endpoints."""

    def __init__(self, view: LiveView) -> None:
        self._view = view
        self._responses = import_extra("starlette.responses", "view", "the live view")

    async def page(self, _: Any) -> Any:
        text = files(__package__).joinpath("page.html").read_text(encoding="utf-8")
        kind = "run" if self._view.stop is not None else "recording"
        text = text.replace("{{token}}", self._view.token).replace("{{kind}}", kind)
        return self._responses.HTMLResponse(text)

    async def asset(self, request: Any) -> Any:
        name = request.path_params["name"]
        if name not in _PAGE_FILES:
            return self._refusal("there is no such file", 404)
        text = files(__package__).joinpath(name).read_text(encoding="utf-8")
        return self._responses.Response(text, media_type=_PAGE_FILES[name])

    async def setting(self, _: Any) -> Any:
        return self._responses.JSONResponse(dict(self._view.setting))

    async def extent(self, _: Any) -> Any:
        times = self._view.store.times_s
        first, last = (times[0], times[-1]) if times else (0.0, 0.0)
        ended = self._view.store.is_ended
        return self._responses.JSONResponse({"first": first, "last": last, "ended": ended})

    async def frame(self, request: Any) -> Any:
        try:
            text = self._view.store.at(float(request.query_params.get("t", "0")))
        except ValueError:
            return self._refusal("t must be a time in s", 400)
        return self._responses.Response(text or "null", media_type="application/json")

    async def stream(self, _: Any) -> Any:
        if self._view.pages >= _MAX_CLIENTS:
            return self._refusal(f"{_MAX_CLIENTS} pages are open already", 503)
        headers = {"Cache-Control": "no-store"}
        return self._responses.StreamingResponse(
            _frames(self._view), media_type="text/event-stream", headers=headers
        )

    async def stop(self, request: Any) -> Any:
        given = request.headers.get("x-palpate-token", "")
        if not secrets.compare_digest(given.encode(), self._view.token.encode()):
            return self._refusal("the token is missing or wrong", 403)
        if self._view.stop is None:
            return self._refusal("nothing runs that could be stopped", 409)
        said = await asyncio.get_running_loop().run_in_executor(None, self._view.stop)
        return self._responses.JSONResponse(dict(said))

    def _refusal(self, why: str, status: int) -> Any:
        return self._responses.PlainTextResponse(why, status)


def application(view: LiveView, port: int) -> Any:
    """The ASGI application."""
    applications = import_extra("starlette.applications", "view", "the live view")
    routing = import_extra("starlette.routing", "view", "the live view")
    pages = _Pages(view)

    @asynccontextmanager
    async def updating(_: Any) -> AsyncIterator[None]:
        task = asyncio.create_task(_keep_up(view))
        yield
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task

    routes = [
        routing.Route("/", pages.page),
        routing.Route("/setting", pages.setting),
        routing.Route("/extent", pages.extent),
        routing.Route("/frame", pages.frame),
        routing.Route("/stream", pages.stream),
        routing.Route("/stop", pages.stop, methods=["POST"]),
        routing.Route("/{name}", pages.asset),
    ]
    return _Guard(applications.Starlette(routes=routes, lifespan=updating), port)


class _Guard:
    """Refuses requests by other host names and of other sites' pages; says what pages may load."""

    def __init__(self, application: Any, port: int) -> None:
        self._application = application
        self._hosts = {f"{name}:{port}" for name in _HOST_NAMES}
        self._origins = {f"http://{host}" for host in self._hosts}

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] == "http":
            headers = {
                name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]
            }
            origin = headers.get("origin")
            if headers.get("host") not in self._hosts or (origin is not None and origin not in self._origins):
                await _refuse(send)
                return
        await self._application(scope, receive, _add_policy(send))


def _add_policy(send: Any) -> Any:
    async def sent(message: Any) -> None:
        if message["type"] == "http.response.start":
            added = {
                "content-security-policy": _POLICY,
                "x-content-type-options": "nosniff",
                "referrer-policy": "no-referrer",
                "cross-origin-resource-policy": "same-origin",
            }
            pairs = [(name.encode(), value.encode()) for name, value in added.items()]
            message = {**message, "headers": [*message["headers"], *pairs]}
        await send(message)

    return sent


async def _refuse(send: Any) -> None:
    headers = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": b"only pages of this server may ask"})


async def _keep_up(view: LiveView) -> None:
    loop = asyncio.get_running_loop()
    while True:
        await loop.run_in_executor(None, view.update)
        await asyncio.sleep(_PERIOD_S)


async def _frames(view: LiveView) -> AsyncIterator[str]:
    """The newest frame whenever there is one; those that a slow page has missed are counted."""
    view.pages += 1
    try:
        sent = view.store.count - 1
        while True:
            count = view.store.count
            if count > sent and view.store.texts:
                missed = count - sent - 1 if sent >= 0 else 0
                view.skipped += missed
                sent = count
                yield f"data: {view.store.texts[-1]}\n\n"
            elif view.store.is_ended:
                yield f"event: end\ndata: {json.dumps({'skipped': view.skipped})}\n\n"
                return
            await asyncio.sleep(_PERIOD_S)
    finally:
        view.pages -= 1


def serve(view: LiveView, port: int, ready: Callable[[str], None]) -> None:
    """Serve until interrupted; `ready` is told the page's address. Raises OSError if the port is taken."""
    listening = socket.create_server((HOST, port))
    uvicorn = import_extra("uvicorn", "view", "the live view")
    config = uvicorn.Config(
        application(view, port),
        log_level="error",
        access_log=False,
        timeout_graceful_shutdown=1,
    )
    ready(f"http://{HOST}:{port}/")
    with closing(listening):
        uvicorn.Server(config).run([listening])
