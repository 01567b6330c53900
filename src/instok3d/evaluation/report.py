"""Reports as JSON, as a table for the terminal, and as rows for docs/results.md."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from instok3d.evaluation.figures import (
    ALL_COSTS,
    MEANS,
    MEDIANS,
    OBJECTS,
    PICTURES,
    SOLID,
    Figures,
)
from instok3d.evaluation.run import EvaluationReport

KEYS = ("psnr", "ssim", "lpips", "ap", "ap50", "ap25", "rotation_deg", "depth_rel", "groups_used")
"""Figures that a report states first, in this order."""

CAPTURE_KEYS = (*KEYS, "id_agreement")
"""The same for captures."""

ALIGNED_KEYS = ("psnr", "ssim", "lpips", "ap", "ap50", "ap25", "id_agreement")
"""What changes where the target cameras are fitted to their photos."""

_DECIMALS = {
    "psnr": 2, "rotation_deg": 2, "groups_used": 1, "objects_per_instance": 2, "gaussians": 0,
    "semantic_units": 0, "label_scalars": 0, "feature_scalars": 0, "fit_s": 2, "peak_mb": 0,
}  # fmt: skip

RESULTS_HEADER = (
    "| protocol | geometry | model | rooms | targets | PSNR | SSIM | LPIPS | AP | AP50 | AP25 "
    "| rotation (deg) | depth (rel) | groups | command | commit | seed | machine |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|"
)
"""Head of the table that `results_rows` fills; it holds this project's own figures alone."""


_OBJECT_COLUMNS = ("objects per instance", "whole", "purity", "by weight", "found", "small found",
                   "fragments", "whole of the others")  # fmt: skip
"""Of OBJECTS, where they were asked for."""
_COST_COLUMNS = ("Gaussians", "semantic units", "label numbers", "feature numbers", "scene (s)",
                 "picture (s)", "peak (MB)")  # fmt: skip
"""Of ALL_COSTS, likewise."""


def as_json(report: EvaluationReport, *, details: bool = False) -> dict[str, Any]:
    """The report as one JSON object: protocol, model, scenes and KEYS; null = not measured.

    `objects` has OBJECTS, `instances_3d` SOLID, `costs` ALL_COSTS where they were asked for. Of
    captures it has CAPTURE_KEYS and `targets`, `outlined_targets` (the target views behind AP),
    `captures` (the same of each capture) and `aligned` (ALIGNED_KEYS and the `steps`, or null).

    Args:
        report: What was measured.
        details: Adds the key `details`: settings, in how many scenes targets were rendered at true
            cameras, levels, baselines, further figures, seeds of rooms or names of scenes.
    """
    figures = report.figures
    result: dict[str, Any] = {
        "protocol": report.protocol,
        "model": report.model,
        "scenes": figures.scenes,
        **_known_as(figures, KEYS),
    }
    if report.of_captures:
        aligned = report.aligned
        result |= _capture_json(figures, aligned and aligned.figures, aligned)
        result["captures"] = {
            name: {
                **_known_as(each, KEYS),
                **_capture_json(each, aligned and aligned.levels[name], aligned),
            }
            for name, each in report.levels.items()
        }
    if report.settings.objects:
        result["objects"] = _known_as(figures, OBJECTS)
    if report.settings.instances_3d:
        result["instances_3d"] = _known_as(figures, SOLID)
    if report.settings.costs:
        result["costs"] = _known_as(figures, ALL_COSTS)
    if details:
        result["details"] = {
            "settings": asdict(report.settings),
            "lpips_trunk": report.lpips_trunk,
            "true_targets": report.true_targets,
            "figures": _all(figures),
            "levels": {level: _all(each) for level, each in report.levels.items()},
            "baselines": {name: _all(each) for name, each in report.baselines.items()},
            **(
                {"seeds": [int(name) for name in report.scenes]}
                if report.of_rooms
                else {"scenes": list(report.scenes)}
            ),
        }
    return result


def as_table(report: EvaluationReport) -> str:
    """The report for a terminal: a row for the model, each level and each baseline, and notes."""
    word = "rooms" if report.of_rooms else "scenes"
    keys, aligned = _keys(report), report.aligned
    rows = [("", word, *(key.replace("_", " ") for key in keys))]
    levels = report.levels if report.of_rooms or len(report.levels) > 1 else {}
    named = {f"all {word}": report.figures, **levels, **report.baselines}
    for name, figures in named.items():
        rows.append((name, str(figures.scenes), *_cells(figures, keys)))
    if aligned is not None:
        fitted = {name: aligned.levels[name] for name in levels}
        for name, figures in {f"all {word}": aligned.figures, **fitted}.items():
            rows.append((f"{name}, aligned", str(figures.scenes), *_cells(figures, keys)))
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) if not column else cell.rjust(width)
                  for column, (cell, width) in enumerate(zip(row, widths, strict=True)))
        for row in rows
    ]  # fmt: skip
    head = f"{report.protocol}, geometry {report.settings.geometry}, model {report.model}"
    return "\n".join([head, "", *lines, "", *notes(report)])


def notes(report: EvaluationReport) -> list[str]:
    """Sentences that belong to the figures: the rules of AP, and what is missing and why."""
    ap = report.settings.ap
    figures = report.figures
    word = "rooms" if report.of_rooms else "scenes"
    lines = [
        f"AP: instances of at least {ap.min_instance_area} pixels, masks of at least "
        f"{ap.min_predicted_area}, void pixels {ap.void}d, confidence = mean map, pooled over "
        f"{figures.counts['masks']} target views; mean over {word} "
        f"{_text(figures.ap_scene_mean)} / {_text(figures.ap50_scene_mean)} / "
        f"{_text(figures.ap25_scene_mean)}; instances of at least 50 pixels "
        f"{_text(figures.ap_large)} / {_text(figures.ap50_large)} / "
        f"{_text(figures.ap25_large)} (AP / AP50 / AP25); over ScanNet's .50:.05:.90 "
        f"AP is {_text(figures.ap_scannet)}."
    ]
    if figures.ap is None:
        lines = ["AP was not measured: the scenes or the method know no instances."]
    lines += _missing(figures, word)
    if report.lpips_trunk is None:
        lines.append("LPIPS was not measured: no weights were given (--lpips).")
    elif report.lpips_trunk != "vgg16":
        lines.append(f"LPIPS is by {report.lpips_trunk}; published figures are by vgg16.")
    lines += _geometry_notes(report, word)
    if report.settings.objects:
        lines += _object_notes(figures)
    if report.settings.instances_3d:
        lines.append(
            f"Instances in space: AP over .50:.05:.90 {_text(figures.ap_3d)}, AP50 "
            f"{_text(figures.ap50_3d)}, AP25 {_text(figures.ap25_3d)}."
        )
    if figures.gaussians is not None:
        lines.append(_cost_note(figures))
    if report.settings.pixels:
        lines.append(f"The model saw the photos at {report.settings.pixels} pixels.")
    if report.settings.disturb:
        lines.append(f"The context photos were disturbed: {report.settings.disturb}.")
    if report.settings.refine:
        lines.append(
            f"The Gaussians were refined on the context photos, {report.settings.refine} steps."
        )
    if report.settings.clean_up:
        lines.append(
            "Groups that hold one thing were joined, loose pieces given to what is around."
        )
    if report.settings.pose_alignment_steps:
        lines.append(_alignment_note(report))
    if report.aligned is not None:
        lines.append(f"Aligned: {_alignment_note(report.aligned)}")
    if report.of_captures:
        known = figures.counts["masks"]
        lines.append(f"{known} of {figures.targets} target views have outlines to compare with.")
        lines.append(
            "Id agreement: share of the pixels of each view whose surface has the same id in the "
            "other views that see it."
        )
    return lines


def _alignment_note(report: EvaluationReport) -> str:
    return (
        "Target cameras were refined against the target photos by "
        f"{report.settings.pose_alignment_steps} steps of pose alignment."
    )


def _cost_note(figures: Figures) -> str:
    return (
        f"A scene has {figures.gaussians:.0f} Gaussians, {figures.semantic_units:.0f} units with "
        f"semantics, {figures.label_scalars:.0f} numbers for labels and "
        f"{figures.feature_scalars:.0f} for features; it takes {figures.fit_s:.2f} s, a "
        f"picture with its masks {1000 * (figures.picture_s or 0):.0f} ms{_peak_words(figures)}."
    )


def _peak_words(figures: Figures) -> str:
    return "" if figures.peak_mb is None else f"; at most {figures.peak_mb:.0f} MB were held"


def _object_notes(figures: Figures) -> list[str]:
    """The figures of objects in words."""
    counts = figures.counts
    return [
        f"Objects in the context views: {counts['objects']}, "
        f"{_text(figures.objects_per_instance, 2)} for each instance seen; "
        f"{_text(figures.whole_share)} of them have IoU >= .5 with an instance, purity "
        f"{_text(figures.purity)}, by weight {_text(figures.purity_by_weight)}; "
        f"{_text(figures.found_share)} of the instances are found, of the "
        f"{counts['small_instances']} under 1 % of the pixels {_text(figures.small_found_share)}; "
        f"{_text(figures.fragment_share)} are fragments, of the others "
        f"{_text(figures.listed_whole_share)} are whole."
    ]


def _geometry_notes(report: EvaluationReport, word: str) -> list[str]:
    """What the model was given, where targets were rendered, errors of cameras and depth."""
    figures, true = report.figures, report.true_targets
    if report.settings.geometry == "given":
        return ["Cameras and depth were given: their errors are not measured."]
    lines = []
    if report.settings.geometry == "intrinsics":
        lines.append("The model was conditioned on the intrinsics of the photos.")
    if true:
        which = "Targets" if true == figures.scenes else f"Targets of {true} {word}"
        lines.append(f"{which} were rendered at their true cameras, in the unit of the data.")
    if true < figures.scenes:
        line = "Target cameras were brought into the predicted world by the context cameras alone"
        if figures.psnr_depth_scaled is not None:
            line += "; with the length from true depth instead, PSNR is "
            line += _text(figures.psnr_depth_scaled)
        lines.append(f"{line}.")
    errors = f"Baselines between context views: {_text(figures.direction_deg)} degrees off in "
    errors += "direction"
    if figures.depth_rel is None:
        return [*lines, f"{errors}. No true depth is known."]
    return [
        *lines,
        f"{errors}, {_text(figures.length_rel)} in length. Depth without a scale: "
        f"{_text(figures.depth_rel_unscaled)}.",
    ]


def results_header(report: EvaluationReport) -> str:
    """RESULTS_HEADER, with the word for what was measured, same ids for captures, and objects."""
    header = RESULTS_HEADER if report.of_rooms else RESULTS_HEADER.replace("rooms", "scenes")
    more = ["same id"] * report.of_captures + [*_OBJECT_COLUMNS] * report.settings.objects
    more += ["AP 3D", "AP50 3D", "AP25 3D"] * report.settings.instances_3d
    more += [*_COST_COLUMNS] * report.settings.costs
    columns = "".join(f" {name} |" for name in more)
    return header.replace("| groups |", f"| groups |{columns}") + "---|" * len(more)


def results_rows(
    report: EvaluationReport, *, command: str, commit: str, seed: int | None, machine: str
) -> str:
    """Rows of docs/results.md under `results_header`: the model, the baselines, aligned targets.

    Args:
        report: What was measured.
        command: The command line that measured it.
        commit: Of the code.
        seed: That the model was trained with; None where its card does not say.
        machine: What it ran on.
    """
    model = report.model
    if report.settings.pixels:
        model += f", photos of {report.settings.pixels} pixels"
    if report.settings.refine:
        model += f", refined {report.settings.refine} steps"
    if report.settings.clean_up:
        model += ", cleaned up"
    if report.settings.disturb:
        model += f", photos disturbed: {report.settings.disturb}"
    named = {model: report.figures, **report.baselines}
    geometry = report.settings.geometry
    if geometry != "given" and report.true_targets:
        geometry += ", true targets"
    if report.settings.pose_alignment_steps:
        geometry += f", targets aligned in {report.settings.pose_alignment_steps} steps"
    rows = "\n".join(
        "| "
        + " | ".join(
            [
                report.protocol,
                geometry,
                name,
                str(figures.scenes),
                str(figures.targets),
                *_cells(figures, _keys(report)),
                f"`{command}`",
                commit,
                "-" if seed is None else str(seed),
                machine,
            ]
        )
        + " |"
        for name, figures in named.items()
    )
    if report.aligned is None:
        return rows
    aligned = results_rows(
        report.aligned, command=command, commit=commit, seed=seed, machine=machine
    )
    return f"{rows}\n{aligned}"


def _keys(report: EvaluationReport) -> Sequence[str]:
    keys = CAPTURE_KEYS if report.of_captures else KEYS
    keys = (*keys, *OBJECTS) if report.settings.objects else keys
    keys = (*keys, *SOLID) if report.settings.instances_3d else keys
    return (*keys, *ALL_COSTS) if report.settings.costs else keys


def _cells(figures: Figures, keys: Sequence[str]) -> Sequence[str]:
    return [_text(getattr(figures, key), _DECIMALS.get(key, 3)) for key in keys]


def _known_as(figures: Figures, keys: Sequence[str]) -> dict[str, Any]:
    return {key: _rounded(getattr(figures, key)) for key in keys}


def _capture_json(
    figures: Figures, fitted: Figures | None, aligned: EvaluationReport | None
) -> dict[str, Any]:
    """What the report of captures has beside KEYS."""
    steps = 0 if aligned is None else aligned.settings.pose_alignment_steps
    return {
        "id_agreement": _rounded(figures.id_agreement),
        "targets": figures.targets,
        "outlined_targets": figures.counts["masks"],
        "aligned": None if fitted is None else {"steps": steps, **_known_as(fitted, ALIGNED_KEYS)},
    }


def _text(value: float | None, decimals: int = 3) -> str:
    return "-" if value is None else f"{value:.{decimals}f}"


def _rounded(value: Any) -> Any:
    return round(value, 6) if isinstance(value, float) else value


def _all(figures: Figures) -> dict[str, Any]:
    return {name: _rounded(value) for name, value in asdict(figures).items()}


def _missing(figures: Figures, word: str) -> list[str]:
    """Sentences on figures that are known for a part alone."""
    counts, lines = figures.counts, []
    if 0 < counts["ap"] < figures.scenes:
        lines.append(
            f"{counts['ap']} of {figures.scenes} {word} have an instance that is asked for; the "
            "others add no instance to AP and are not in its mean over them."
        )
    for kind, names, total in (
        ("target views", PICTURES, figures.targets),
        ("samples", (*MEANS, *MEDIANS), figures.samples),
    ):
        partly: dict[int, list[str]] = {}
        for name in names:
            if 0 < counts[name] < total:
                partly.setdefault(counts[name], []).append(name)
        lines += [
            f"Known for {count} of {total} {kind} alone: {', '.join(sorted(each))}."
            for count, each in partly.items()
        ]
    return lines
