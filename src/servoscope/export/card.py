"""The card of an exported model: what it takes, what it gives, and how far it can be trusted."""

from __future__ import annotations

from collections.abc import Mapping

from servoscope import __version__
from servoscope.dofs import mask_of
from servoscope.export.agreement import EQUAL, Agreement
from servoscope.export.graph import OPSET
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
from servoscope.positioning.keyframe_model import KeyframeModel
from servoscope.positioning.model import PositioningModel
from servoscope.positioning.settings import NEAR_ENOUGH, LoopSettings
from servoscope.report.table import Table
from servoscope.wording import plain_number

_MEANING = {
    "displacement": "`inv(T_world_ref) @ T_world_cam` of the frame whose poses the robot "
    "reported in training, row by row [m]",
    "correction": "the inverse of `displacement`",
    "delta_p": "the displacement about the pivot: tx ty tz [m], then the Euler angles rx ry rz "
    "[rad] of `Rz(rz) Ry(ry) Rx(rx)`",
    "deviation": "standard deviation that is believed of each number of `delta_p`; NaN in dofs "
    "that are not commanded",
    "similarity": "median correlation of the image with what is expected at the displacement",
    "novelty": "how unlike the images of the part it is; 1 is the most that is recognised",
    "is_recognised": "whether the similarity and the displacement are those of this part; if "
    "not, all other outputs mean nothing",
}
_TYPES = {"is_recognised": "bool"}


def model_card(
    model: PositioningModel,
    name: str,
    outputs: Mapping[str, tuple[int, ...]],
    fingerprint: str,
    size_mb: float,
    agreement: Agreement | None,
) -> str:
    """The card as Markdown."""
    height, width = model.image_shape
    rows = [["`image`", "input", "uint8", f"{height} x {width}", "grey levels, row by row"]]
    rows += [
        [
            f"`{output}`",
            "output",
            _TYPES.get(output, "float64"),
            " x ".join(map(str, shape)) or "scalar",
            _MEANING[output],
        ]
        for output, shape in outputs.items()
    ]
    parts = [
        f"# {name}",
        "Tells from one image how far a camera is displaced from where the reference image was "
        f"taken. Exported by servoscope {__version__}; ONNX opset {OPSET}, operators of the "
        f"standard domain alone, {size_mb:.1f} MB.",
        f"SHA-256 of the file: `{fingerprint}`",
        "## Inputs and outputs",
        Table(["name", "", "type", "shape", "meaning"], rows, align="l").to_markdown(),
        "## Use",
        "\n".join(
            [
                f"- Stop if `is_recognised` is false: {_strangers(model)}.",
                "- Otherwise the camera is brought back by moving the robot by `correction` in its "
                "own axes: `T_new = T_now @ correction`.",
                f"- {_workspace(model)}",
                "- One look far from the reference is less accurate than one near it: look again "
                "after each move, until `delta_p` is as small as `deviation`.",
                f"- The pivot is {1e3 * model.pivot:.6g} mm along z of the reported frame.",
                "- The graph knows no image before. It always searches the whole range, where "
                "the loop of servoscope begins near the reference once it has moved.",
                "- What the loop of servoscope watches besides (exposure, frozen images, steps "
                "that do not shrink) is the controller's to watch.",
                "- The file's metadata hold this as JSON, in metres and radians: `workspace` "
                "(least x, y, z, greatest; 1e6 is no limit), `pivot`, `dofs`, `reads`, `reach`, "
                "`tolerance` (always near enough), `least_similarity`.",
            ]
        ),
        "## Accuracy of the model",
        _accuracy(model),
        "## Equality with the model that it was made of",
        _equality(agreement),
    ]
    return "\n\n".join(parts) + "\n"


def _strangers(model: PositioningModel) -> str:
    """What an image shows that is not recognised."""
    if isinstance(model, KeyframeModel):
        return (
            "the image then shows something else, is covered, or was taken too far away "
            f"(similarity below {model.least_similarity:.4g}, or beyond twice the range of "
            "translations or 1.5 times that of rotations)"
        )
    return (
        "the image then has other features than the part has at the displacement that is read "
        "(`novelty` above 1; `similarity` is not known and NaN)"
    )


def _workspace(model: PositioningModel) -> str:
    workspace = LoopSettings().robot_box(model)
    if not workspace.is_limited:
        return (
            "Its images were taken without a workspace: the file sets no limit to where the robot "
            "goes."
        )
    return (
        f"Its images were taken inside {workspace} of the robot's coordinates. Refuse a `T_new` "
        "outside."
    )


def _accuracy(model: PositioningModel) -> str:
    median, ninety = (model.accuracy.get(name, {}) for name in ("median", "quantile_90"))
    commanded = mask_of(model.dofs)
    rows = []
    for k, (dof, unit) in enumerate(zip(DOFS, DISPLAY_UNITS, strict=True)):
        shown = [
            f"{plain_number(part[dof])} {unit}" if dof in part else "–" for part in (median, ninety)
        ]
        reach = f"+-{DISPLAY_FACTORS[k] * model.reach[k]:.4g} {unit}"
        rows.append([dof, "yes" if commanded[k] else "no", reach, *shown])
    heads = ["dof", "commanded", "range", "median error", "90 % are below"]
    words = (
        "Absolute errors of single images that were held out in training, about the pivot, over "
        "the whole range:"
    )
    return f"{words}\n\n{Table(heads, rows, align='llr').to_markdown()}"


def _equality(agreement: Agreement | None) -> str:
    if agreement is None:
        return "Not checked."
    found = agreement.to_dict()
    rows = [
        [row["dof"], f"{row['median']:.2g} {row['unit']}", f"{row['worst']:.2g} {row['unit']}"]
        for row in found["dofs"]
    ]
    words = (
        f"Under onnxruntime on one core, on {agreement.n_images} images, the model's own answer "
        "less that of this file:"
    )
    more = (
        f"The tolerance of a dof is the deviation that is believed of it, but no less than "
        f"{NEAR_ENOUGH['mm']:g} mm and {NEAR_ENOUGH['deg']:g} deg. Both agree to {EQUAL:g} of it "
        f"on {agreement.equal:.0%} of the images; the greatest difference is "
        f"{agreement.worst_share:.2g} of it. Deviations differ by "
        f"{agreement.deviation:.2g} of themselves at most, similarities by "
        f"{agreement.similarity:.2g}. Differences come from rounding."
    )
    return f"{words}\n\n{Table(['dof', 'median', 'worst'], rows).to_markdown()}\n\n{more}"
