import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("PIL", reason="needs the extra 'pictures'")

from PIL import Image

from demoplan.engines.mujoco import drawing
from demoplan.engines.mujoco.drawing import DrawParams, require_drawing, save_picture, save_video
from demoplan.engines.mujoco.filming import Film
from demoplan.engines.mujoco.opening import open_session
from demoplan.engines.mujoco.scene import cube_names
from demoplan.engines.mujoco.scene_spec import random_scene
from demoplan.engines.mujoco.session import Motion
from demoplan.errors import SimulationError, UnknownNameError, UsageError

SMALL = DrawParams(width=120, height=80)


@pytest.fixture(scope="module")
def film():
    kept = Film(rate_hz=20.0)
    session = open_session(random_scene(cube_names(2), seed=0), seed=0, film=kept)
    session.advance(0.2)
    session.start("Right_hand", Motion(activity="Reach", skill="reach", object="cube_red"))
    session.advance(1.8)
    return kept


def test_a_film_keeps_what_was_at_its_rate_and_a_session_without_one_runs_the_same(film):
    assert len(film.time_ns) == pytest.approx(40, abs=2)
    assert min(np.diff(film.time_ns)) >= 50_000_000
    session = open_session(random_scene(cube_names(2), seed=0), seed=0)
    session.advance(0.2)
    session.start("Right_hand", Motion(activity="Reach", skill="reach", object="cube_red"))
    session.advance((film.time_ns[-1] - session.time_ns) / 1e9)
    assert np.array_equal(session.data.qpos, film.positions[-1])


def test_a_picture_shows_the_cubes_and_a_video_moves(film, tmp_path):
    try:
        require_drawing(tmp_path / "end.png", tmp_path / "run.gif", "egl")
    except SimulationError as error:
        pytest.skip(str(error))
    save_picture(film, tmp_path / "end.png", params=SMALL)
    picture = np.asarray(Image.open(tmp_path / "end.png")).astype(int)
    assert picture.shape == (80, 120, 3)
    red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    assert ((red > 100) & (green < 60) & (blue < 60)).any()
    save_video(film, tmp_path / "run.gif", params=SMALL)
    with Image.open(tmp_path / "run.gif") as video:
        assert video.n_frames >= 4
        first = np.asarray(video.convert("RGB")).copy()
        video.seek(video.n_frames - 1)
        assert (np.asarray(video.convert("RGB")) != first).any()


def test_what_cannot_be_drawn_is_refused_before_anything_runs(film, tmp_path, monkeypatch):
    with pytest.raises(UsageError, match=r"'\.mp4'; available: \.gif, \.webp"):
        require_drawing(None, tmp_path / "run.mp4", "egl")
    with pytest.raises(UnknownNameError, match="unknown way to draw 'metal'"):
        require_drawing(tmp_path / "end.png", None, "metal")
    with pytest.raises(UsageError, match="nothing to draw"):
        save_picture(Film(), tmp_path / "end.png")

    def missing(name):
        if name.startswith("mujoco."):
            raise ImportError("no such library")
        return Image

    monkeypatch.setattr(drawing, "import_module", missing)
    with pytest.raises(SimulationError, match=r"libegl1.*DEMOPLAN_GL=osmesa \(libosmesa6\); runs themselves"):
        require_drawing(tmp_path / "end.png", None, "egl")
