"""Images chosen where most is learned against images drawn at random, and forecasts against truth.

``python -m benchmarks next_images``: fifteen images of the simulated cell, then ten more.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.keyframe import CELLS, DOFS, PIVOT, RANGES
from benchmarks.tables import Findings
from servoscope import AcquisitionConfig, Keyframe, acquire
from servoscope.acquisition.simulated import take_image
from servoscope.acquisition.until import FIRST, N_GROUPS, NEXT, acquire_until
from servoscope.data.images import PoseImageSet
from servoscope.dofs import parse_accuracy
from servoscope.keyframe import forecast_accuracy, next_displacements, read_held_out
from servoscope.poses import (
    DISPLAY_FACTORS,
    displacements_from_poses,
    inverse_transform,
    poses_from_displacements,
)
from servoscope.scene.render import render
from servoscope.scene.scene import T_WORLD_REF, Scene

POSE_NOISE = (5e-5, np.radians(0.01))
SIZES = (FIRST, FIRST + NEXT)
REQUEST = "t=0.1mm,r=0.04deg"

Errors = Callable[[Keyframe, np.ndarray], np.ndarray]


def tables(quick: bool) -> Iterator[Findings]:
    """Chosen against random images; forecasts against what other images show."""
    names = list(CELLS)[:1] if quick else list(CELLS)
    seeds = range(1 if quick else 3)
    with threadpool_limits(1):
        errors = {name: _errors(name, 8 if quick else 40) for name in names}
        yield _chosen([name for name in names if "plane" not in name], seeds, errors)
        yield _forecasts(names, seeds[:2], errors, SIZES[:1] if quick else SIZES)
        if not quick:
            yield _until(errors["head on the arm"])


def _chosen(names: list[str], seeds: range, errors: dict[str, Errors]) -> Findings:
    rows: list[tuple[str, ...]] = []
    for name in names:
        ratios = []
        for seed in seeds:
            config, data = _data(name, FIRST + NEXT, seed)
            first = data.images[:FIRST], data.T_world_cam[:FIRST]
            few = _fit(*first, data)
            delta_p = next_displacements(
                few, NEXT, RANGES, pose_noise=POSE_NOISE, random_state=seed
            )
            added = [
                take_image(config, data.T_world_ref, FIRST + i, d)[:2]
                for i, d in enumerate(delta_p)
            ]
            more = zip(*added, strict=True)
            both = (np.concatenate(pair) for pair in zip(first, more, strict=True))
            fits = few, _fit(data.images, data.T_world_cam, data), _fit(*both, data)
            medians = [np.median(errors[name](k, data.T_world_ref), axis=0) for k in fits]
            for label, median in zip(
                (f"{FIRST} images", f"+ {NEXT} at random", f"+ {NEXT} chosen"), medians, strict=True
            ):
                rows.append(_row(f"{name}, draw {seed}: {label}", median))
            ratios.append(np.log(medians[2] / medians[1]))
        rows.append(_row(f"{name}: chosen / random", np.exp(np.mean(ratios, axis=0))))
    return Findings(
        "Images chosen where most is learned",
        f"{FIRST} images drawn from the range, and {NEXT} more; median errors of one look at 40 "
        "others, exact poses; the last rows are geometric means over the draws",
        ("what", *DOFS),
        rows,
    )


def _forecasts(
    names: list[str], seeds: range, errors: dict[str, Errors], sizes: tuple[int, ...]
) -> Findings:
    rows: list[tuple[str, ...]] = []
    ratios = []
    for name in names:
        for seed in seeds:
            _, data = _data(name, max(sizes), seed)
            for n in sizes:
                images, poses = data.images[:n], data.T_world_cam[:n]
                looks = read_held_out(
                    images, poses, data.reference_image, data.T_world_ref,
                    np.arange(n) % N_GROUPS, pivot=data.pivot,
                )  # fmt: skip
                keyframe = _fit(images, poses, data)
                found = forecast_accuracy(
                    keyframe, looks, data.delta_p()[:n], RANGES, pose_noise=POSE_NOISE
                )
                median = np.median(errors[name](keyframe, data.T_world_ref), axis=0)
                rows.append(
                    _row(f"{name}, draw {seed}, {n}: forecast", found.look * DISPLAY_FACTORS)
                )
                rows.append(_row(f"{name}, draw {seed}, {n}: true", median))
                ratios.append(found.look * DISPLAY_FACTORS / median)
    ratio = np.array(ratios)
    for label, row in (
        ("true error at most the forecast", np.mean(ratio >= 1, axis=0)),
        ("true error at most 1.5 times the forecast", np.mean(ratio >= 1 / 1.5, axis=0)),
        ("median of forecast / truth", np.median(ratio, axis=0)),
    ):
        rows.append(_row(label, row))
    return Findings(
        "Forecasts of one look against the truth",
        "median error of one look from anywhere in the range: forecast from three groups held out, "
        "and found at 40 others, exact poses; the last rows are shares of the cases",
        ("what", *DOFS),
        rows,
    )


def _row(label: str, values: Iterable[float]) -> tuple[str, ...]:
    return label, *(f"{value:.2g}" for value in values)


def _until(errors: Errors) -> Findings:
    rows: list[tuple[str, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        config = AcquisitionConfig(n_images=100, robot="arm")
        data = acquire_until(Path(folder) / "arm", config, parse_accuracy(REQUEST), n_jobs=1)
    forecast = data.source["forecast"]
    median = np.median(errors(_fit(data.images, data.T_world_cam, data), data.T_world_ref), axis=0)
    rows.append(_row(f"{len(data)} images: forecast", forecast["look"].values()))
    rows.append(_row(f"{len(data)} images: true", median))
    return Findings(
        "Moves of the arm for a stated accuracy",
        f"servoscope acquire arm --robot arm --until {REQUEST}; a move an image",
        ("what", *DOFS),
        rows,
    )


def _data(name: str, n: int, seed: int) -> tuple[AcquisitionConfig, PoseImageSet]:
    part, robot, _, _ = CELLS[name]
    config = AcquisitionConfig(schedule=((n, 1.0),), part=part, robot=robot, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        return config, acquire(Path(folder) / "data", config, n_jobs=1)


def _fit(images: np.ndarray, T_world_cam: np.ndarray, data: PoseImageSet) -> Keyframe:
    return Keyframe.fit(
        images, T_world_cam, data.reference_image, data.T_world_ref, pivot=data.pivot
    )


def _errors(name: str, n: int) -> Errors:
    """What gives the absolute errors of one look at images at exact poses, [mm] and [deg]."""
    _, _, shape, mount = CELLS[name]
    scene, rng = Scene(part=shape), np.random.default_rng(5)
    delta_p = rng.uniform(-1, 1, (n, 6)) * RANGES
    T_cam = poses_from_displacements(T_WORLD_REF, delta_p, PIVOT)
    images = [render(scene, T, rng) for T in T_cam]

    def errors(keyframe: Keyframe, T_world_ref: np.ndarray) -> np.ndarray:
        T_flange = T_cam @ inverse_transform(mount)
        true = displacements_from_poses(T_world_ref, T_flange, keyframe.pivot)
        found = np.array([keyframe.align(image).delta_p for image in images])
        return np.abs(found - true) * DISPLAY_FACTORS

    return errors
