import io
from xml.etree import ElementTree

import numpy as np
from PIL import Image

from servoscope.report.figure import (
    Caption,
    FigureOrder,
    draw_figures,
    new_mosaic,
    plot_mosaic,
    render,
)


def draw():
    image = np.arange(256, dtype=np.uint8).reshape(16, 16)
    figure, ax = new_mosaic(image.shape, 1)
    plot_mosaic([image], [""], ax=ax, cmap="gray", vmin=0, vmax=255)
    return figure


def test_grey_pictures_keep_their_greys_and_say_what_they_show():
    file = render(FigureOrder("grey", Caption("Greys", "a < b", '"all" greys', 3), draw))
    png = Image.open(io.BytesIO(file.png))
    assert png.mode == "L"
    assert len(png.getcolors()) > 200
    html = file.to_html()
    assert 'alt="&quot;all&quot; greys"' in html
    assert "<b>Greys.</b> a &lt; b" in html
    assert "the paper's figure 3" in html


def test_processes_make_no_difference(tmp_path):
    orders = [FigureOrder(name, Caption(name, "", ""), draw) for name in ("a", "b")]
    one, two = (draw_figures(orders, tmp_path / str(n), n_jobs=n) for n in (1, 2))
    assert one == two
    assert sorted(path.name for path in (tmp_path / "2").iterdir()) == ["a.png", "b.png"]


def test_figures_are_svg_too_where_that_is_asked_for(tmp_path):
    order = FigureOrder("grey", Caption("Greys", "", ""), draw)
    (file,) = draw_figures([order], tmp_path, n_jobs=1, svg=True)
    written = (tmp_path / "grey.svg").read_bytes()
    assert ElementTree.fromstring(written).tag == "{http://www.w3.org/2000/svg}svg"  # noqa: S314
    assert written == file.svg == render(order, svg=True).svg
    assert (tmp_path / "grey.png").read_bytes() == render(order).png
