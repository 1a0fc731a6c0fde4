"""The HTTP service over real sockets: answers, refusals, and what nobody should send."""

import json
import re
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from http.client import HTTPConnection

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.cli import main
from servoscope.errors import InvalidInputError
from servoscope.poses import displacements_from_poses
from servoscope.positioning import Estimate
from servoscope.service import server as server_module
from servoscope.service.answers import LARGEST_BODY, Answers
from servoscope.service.description import page
from servoscope.service.server import Server
from small_keyframe import PIVOT, shown, small_model, texture

TOKEN = "a token of thirty-two characters"  # noqa: S105


@pytest.fixture(scope="module")
def model():
    return small_model(guesses=False)


@pytest.fixture(scope="module")
def answers(model):
    return Answers(model)


@contextmanager
def running(answers, **options):
    with Server(answers, **options) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture(scope="module")
def server(answers):
    with running(answers) as server:
        yield server


def ask(server, method, path, body=None, **headers):
    connection = HTTPConnection("127.0.0.1", server.server_address[1], timeout=20)
    headers = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    kind = answer.headers["Content-Type"]
    return answer.status, json.loads(content) if kind == "application/json" else content.decode()


def encoded(image, ending=".png"):
    return cv2.imencode(ending, image)[1].tobytes()


@pytest.mark.parametrize("ending", [".png", ".pgm", ".tiff", ".bmp"])
def test_an_image_gives_what_the_model_says(server, model, ending):
    image = shown(model)[1]
    status, found = ask(server, "POST", "/estimate", encoded(image, ending))
    ours = model.estimate(image)
    assert status == 200
    assert found["is_recognised"] is True
    np.testing.assert_array_equal(found["displacement"], ours.displacement)
    six = displacements_from_poses(np.eye(4), ours.displacement[None], PIVOT)[0]
    np.testing.assert_allclose(found["delta_p"], six)
    np.testing.assert_array_equal(found["std"], ours.std)
    assert found["similarity"] == ours.similarity


def test_colour_is_turned_grey(server, model):
    grey = shown(model)[0]
    status, found = ask(server, "POST", "/estimate", encoded(cv2.merge([grey] * 3)))
    assert status == 200
    np.testing.assert_allclose(found["delta_p"], 0, atol=1e-5)


def test_deviations_of_dofs_that_are_not_read_are_null():
    with running(Answers(small_model(dofs=("tx", "ty", "rz"), guesses=False))) as server:
        image = encoded(shown(server.answers.model)[1])
        found = ask(server, "POST", "/estimate", image)[1]
    assert [value is None for value in found["std"]] == [False, False, True, True, True, False]


def test_something_else_is_not_recognised(server):
    other = texture((48, 64), 77).astype(np.uint8)
    assert ask(server, "POST", "/estimate", encoded(other))[1]["is_recognised"] is False


class OfFeatures:
    """A model that knows no similarity, as those of features."""

    kind, image_shape, pivot = "features", (48, 64), PIVOT
    reference_image = np.zeros((48, 64), np.uint8)

    def estimate(self, image):
        return Estimate(np.eye(4), np.full(6, np.nan), float(image[0, 0]), "features")


def test_a_model_without_similarities_is_judged_by_novelty():
    answers = Answers(OfFeatures())
    found = [answers.estimate(encoded(np.full((48, 64), k, np.uint8))) for k in (1, 2)]
    assert [one["is_recognised"] for one in found] == [True, False]
    assert found[0]["similarity"] is None
    assert found[0]["std"] == [None] * 6


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"", "not a whole image"),
        (b"no image", "not a whole image"),
        (encoded(np.zeros((48, 64), np.uint8))[:60], "not a whole image"),
        (encoded(np.zeros((8, 9), np.uint8)), "64 x 48 pixels.*9 x 8"),
        (encoded(np.full((48, 64), 4095, np.uint16)), "--bit-depth"),
    ],
    ids=["nothing", "text", "cut", "size", "sixteen_bits"],
)
def test_what_is_no_image_of_the_model_is_refused(server, body, words):
    status, answer = ask(server, "POST", "/estimate", body)
    assert status == 422
    assert re.search(words, answer["error"])
    assert "skip-bad" not in answer["error"]


def test_a_small_file_that_unfolds_to_a_huge_image_is_refused(server):
    body = b"P5 60000 60000 255\n" + bytes(100)
    status, answer = ask(server, "POST", "/estimate", body)
    assert status == 422
    assert "pixels" in answer["error"]


def test_sixteen_bits_are_read_where_their_depth_is_known(model):
    image = shown(model)[1]
    deep = encoded(image.astype(np.uint16) << 4)
    found = Answers(model, bit_depth=12).estimate(deep)
    np.testing.assert_array_equal(found["displacement"], model.estimate(image).displacement)
    with pytest.raises(InvalidInputError, match="9 bits"):
        Answers(model, bit_depth=9).estimate(deep)


def test_too_much_is_refused_unread(server):
    connection = socket.create_connection(server.server_address[:2], timeout=20)
    head = f"POST /estimate HTTP/1.1\r\nHost: localhost\r\nContent-Length: {LARGEST_BODY + 1}\r\n"
    connection.sendall(head.encode() + b"\r\n")
    assert connection.recv(100).startswith(b"HTTP/1.1 413 ")
    connection.close()


@pytest.mark.parametrize(("ends", "status"), [(True, b" 400 "), (False, b" 408 ")])
def test_a_body_that_never_arrives_is_not_waited_for(server, monkeypatch, ends, status):
    monkeypatch.setattr(server_module, "LONGEST_S", 0.0)
    connection = socket.create_connection(server.server_address[:2], timeout=20)
    head = b"POST /estimate HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000\r\n\r\n"
    connection.sendall(head + b"P5" * (not ends))
    if ends:
        connection.shutdown(socket.SHUT_WR)
    assert status in connection.recv(100)
    connection.close()


@pytest.mark.parametrize(
    ("method", "path", "headers", "status"),
    [
        ("GET", "/nothing", {}, 404),
        ("GET", "/estimate", {}, 405),
        ("POST", "/health", {}, 405),
        ("DELETE", "/estimate", {}, 501),
        ("GET", "/health", {"Host": "evil.example"}, 403),
        ("GET", "/health", {"Host": "evil.example:80"}, 403),
        ("GET", "/health", {"Host": "[::1"}, 403),
        ("GET", "/health", {"Origin": "http://evil.example"}, 403),
        ("POST", "/estimate", {"Transfer_Encoding": "chunked"}, 411),
        ("POST", "/estimate", {"Content_Length": "-1"}, 411),
        ("POST", "/estimate", {"Content_Length": "9" * 30}, 411),
        ("GET", "/health", {"Host": "localhost"}, 200),
        ("GET", "/health", {"Host": "192.0.2.7:8077"}, 200),
    ],
)
def test_requests_get_the_status_that_says_what_is_wrong(server, method, path, headers, status):
    found, answer = ask(server, method, path, **headers)
    assert found == status
    assert ("error" in answer) == (status != 200)


def test_names_that_are_given_are_its_own(answers):
    with running(answers, names=("Cell-7",)) as server:
        assert ask(server, "GET", "/health", Host="cell-7:8077")[0] == 200
        assert ask(server, "GET", "/health", Host="cell-8")[0] == 403


def test_a_token_is_asked_for(answers, model):
    body = encoded(model.reference_image)
    with running(answers, token=TOKEN) as server:
        for given, status in ((f"Bearer {TOKEN}", 200), (f"Bearer {TOKEN}x", 401), ("é", 401)):
            assert ask(server, "POST", "/estimate", body, Authorization=given)[0] == status
        assert ask(server, "POST", "/estimate", body)[0] == 401
        described = ask(server, "GET", "/openapi.json")[1]
    assert described["paths"]["/estimate"]["post"]["security"] == [{"token": []}]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"host": "0.0.0.0"}, "needs a token"),  # noqa: S104
        ({"host": "::"}, "needs a token"),
        ({"token": "short"}, "16 ASCII"),
        ({"port": 70000}, "65535"),
        ({"host": "192.0.2.1", "token": TOKEN}, "--port"),
    ],
)
def test_a_server_that_would_be_open_or_deaf_does_not_start(answers, options, words):
    with pytest.raises(InvalidInputError, match=words):
        Server(answers, **options)


def test_the_api_describes_what_it_answers(server, model):
    status, described = ask(server, "GET", "/openapi.json")
    assert status == 200
    assert described["openapi"] == "3.1.0"
    schema = described["components"]["schemas"]["Estimate"]
    found = ask(server, "POST", "/estimate", encoded(model.reference_image))[1]
    assert set(found) == set(schema["properties"])
    assert set(schema["required"]) <= set(found)
    references = re.findall(r'"\$ref": "#/components/schemas/(\w+)"', json.dumps(described))
    assert set(references) <= set(described["components"]["schemas"])
    assert ask(server, "GET", "/health")[1]["image_size"] == [64, 48]


def test_the_page_asks_nobody_else(server):
    status, shown_page = ask(server, "GET", "/")
    assert status == 200
    assert "POST /estimate" in shown_page
    assert not re.search(r"(src|href)=\"(?!/)|https?://", shown_page)
    assert "default-src 'none'" in page()[1]


def test_several_at_once_get_their_own_answers(server, model):
    images = shown(model)
    alone = [model.estimate(image).displacement for image in images]
    with ThreadPoolExecutor(8) as pool:
        asked = list(range(len(images))) * 3
        found = list(
            pool.map(lambda k: ask(server, "POST", "/estimate", encoded(images[k]))[1], asked)
        )
    for k, answer in zip(asked, found, strict=True):
        np.testing.assert_array_equal(answer["displacement"], alone[k])


def test_connections_are_used_again_and_those_too_many_closed(answers, model, monkeypatch):
    monkeypatch.setattr(server_module, "MOST_CONNECTIONS", 1)
    with running(answers) as server:
        address = server.server_address[:2]
        first = HTTPConnection(*address, timeout=20)
        for _ in range(2):
            first.request("POST", "/estimate", encoded(model.reference_image))
            assert first.getresponse().read()
        second = socket.create_connection(address, timeout=20)
        assert second.recv(1) == b""
        second.close()
        first.close()


@given(st.binary(max_size=200))
def test_any_bytes_get_an_answer_as_json(server, content):
    status, answer = ask(server, "POST", "/estimate", content)
    assert status == 422
    assert len(answer["error"].splitlines()) == 1


PNG = encoded(np.arange(48 * 64, dtype=np.uint8).reshape(48, 64))


@given(st.integers(0, len(PNG) - 1), st.binary(min_size=1, max_size=8))
def test_a_damaged_image_gets_an_answer_as_json(server, place, damage):
    body = PNG[:place] + damage + PNG[place + len(damage) :]
    status, answer = ask(server, "POST", "/estimate", body)
    assert status in (200, 422)
    assert ("error" in answer) == (status == 422)


@given(st.binary(min_size=1, max_size=300))
def test_any_request_line_ends_without_a_trace(server, content):
    connection = socket.create_connection(server.server_address[:2], timeout=20)
    connection.sendall(content.replace(b"\n", b"") + b"\r\n\r\n")
    connection.shutdown(socket.SHUT_WR)
    answer = b"".join(iter(lambda: connection.recv(4096), b""))
    connection.close()
    assert b"Traceback" not in answer
    assert b"200 OK" not in answer


def test_a_fault_of_the_model_is_no_trace(answers, monkeypatch, capsys):
    def fail(content):
        raise RuntimeError("inside\nthe model")

    monkeypatch.setattr(answers, "estimate", fail)
    with running(answers) as server:
        status, answer = ask(server, "POST", "/estimate", b"x")
    assert status == 500
    assert "inside" not in answer["error"]
    assert capsys.readouterr().err == "servoscope: RuntimeError: inside the model\n"


def test_the_command_serves_until_it_is_interrupted(model, tmp_path, capsys, monkeypatch):
    model.save(tmp_path / "model")
    (tmp_path / "token").write_text(TOKEN + "\n")

    def interrupted(self):
        assert self.token == TOKEN
        raise KeyboardInterrupt

    monkeypatch.setattr(Server, "serve_forever", interrupted)
    arguments = ["serve", str(tmp_path / "model"), "--port", "0"]
    assert main([*arguments, "--token-file", str(tmp_path / "token")]) == 0
    said = capsys.readouterr().err.splitlines()
    assert re.fullmatch(
        r"servoscope: serving .* at http://127\.0\.0\.1:\d+/, until Ctrl-C", said[0]
    )
    assert said[1:] == ["servoscope: stopped"]
    assert main([*arguments, "--host", "0.0.0.0"]) == 1  # noqa: S104
    assert "needs a token" in capsys.readouterr().err
