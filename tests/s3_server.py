"""A real S3 server in a process of its own, which can be told to misbehave.

``python s3_server.py`` serves on a free port of loopback and prints its address. ``PUT /-/faults`` with JSON
sets what is to go wrong from now on; see ``Faults``. Requests are served one after the other, so that what is
checked for a conditional write is still so when it is done: the server itself does not promise that.
"""

import json
import sys
import threading
import time
from dataclasses import dataclass


@dataclass
class Faults:
    n: int = 0
    """How many requests are yet to go wrong."""
    method: str = ""
    """Only these; all if empty."""
    kind: str = "500"
    """``500`` before anything is done, ``500-after`` it was done, ``slow``."""
    delay_s: float = 0.0


class Misbehaving:
    def __init__(self, app):
        self.app = app
        self.faults = Faults()
        self.n_requests = 0
        self.lock = threading.Lock()

    def __call__(self, environ, start_response):
        if environ["PATH_INFO"] == "/-/faults":
            length = int(environ.get("CONTENT_LENGTH") or 0)
            if environ["REQUEST_METHOD"] == "PUT":
                self.faults = Faults(**json.loads(environ["wsgi.input"].read(length)))
                self.n_requests = 0
            start_response("200 OK", [("Content-Type", "application/json")])
            return [json.dumps({"n_requests": self.n_requests, "n": self.faults.n}).encode()]
        with self.lock:
            self.n_requests += 1
            is_hit = self.faults.n > 0 and self.faults.method in ("", environ["REQUEST_METHOD"])
            if is_hit:
                self.faults.n -= 1
            kind = self.faults.kind if is_hit else ""
            delay_s = self.faults.delay_s
            if kind != "500":
                answer = self.app(environ, start_response if kind != "500-after" else lambda *_: None)
                body = list(answer)
        if kind == "slow":
            time.sleep(delay_s)
        if kind.startswith("500"):
            start_response("500 Internal Server Error", [("Content-Type", "text/plain")])
            return [b"broken on purpose"]
        return body


def main():
    from moto.server import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import WSGIRequestHandler, make_server

    class Silent(WSGIRequestHandler):
        def log(self, *_):
            pass

    app = Misbehaving(DomainDispatcherApplication(create_backend_app))
    server = make_server("127.0.0.1", 0, app, threaded=True, request_handler=Silent)
    sys.stdout.write(f"http://127.0.0.1:{server.port}\n")
    sys.stdout.flush()
    threading.Thread(target=lambda: (sys.stdin.read(), server.shutdown()), daemon=True).start()
    server.serve_forever()


if __name__ == "__main__":
    main()
