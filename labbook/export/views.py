"""Views of recordings: grains from the front with one of their properties, the bar of colours, W(t), and playback."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from labbook.export.colour_bar import BACKGROUND, colour_bar
from labbook.export.colouring import PALE
from labbook.export.entities import CLOCK, below, is_drawn_as_capsules, need_rerun
from labbook.export.frames import Frame
from labbook.export.wall_shapes import wall_points
from labbook.scene import Scene

_BAR, _PLAIN = "colours", "speeds"
_LASTS = 6.0  # s: duration of playback
_SMALL = 0.3  # of grains beside lines and arrows: radius in parts of their own
_FIELD_OF_VIEW = math.radians(55)  # vertical, of rerun's eye: it cannot be set, nor can a parallel projection
_NARROWEST = 0.9  # width over height of a view that shows all
_MARGIN = 1.08
_SEEN_FROM = math.radians(12)
_GRAIN_COLOURS = ("layers", "speed", "orientation")


def front_view(scene: Scene, frames: Sequence[Frame], *, origin: str = "", name: str, by: str = "layers"):
    """Make a view from the front of grains and walls, all of them in all frames.

    A quasi-2D hopper is seen straight from the front, anything else from a little above.

    Args:
        scene: Scene of the run.
        frames: Frames of the run.
        origin: Entity above grains and walls.
        name: Name of the view.
        by: Property that grains are coloured by, `layers`, `speed` or `orientation`; or an entity beside small and pale
            grains, such as `forces`. `mean_flow` is shown without grains.

    Returns:
        View of rerun.
    """
    rr = need_rerun()
    import rerun.blueprint as rrb
    from rerun.blueprint.encodings import VisualizerComponentMapping

    shape = rr.Capsules3D if is_drawn_as_capsules(scene.grains) else rr.Points3D
    grains, overrides = f"/{below(origin)}grains", dict[Any, Any]()
    if by not in _GRAIN_COLOURS:
        small = _SMALL * scene.grains.radius
        overrides[grains] = shape.from_fields(colors=[PALE], radii=[small])
    elif by != "layers":
        source = VisualizerComponentMapping(
            f"{shape.__name__}:colors", "SourceComponent", source_component=f"{by}:colors"
        )
        overrides[grains] = shape.from_fields().visualizer(mappings=[source])
    eye, middle = seen_from(scene, np.concatenate([frame.x for frame in frames]))
    contents = ["$origin/walls/**"]
    contents += [] if by == "mean_flow" else ["$origin/grains"]
    contents += [] if by in _GRAIN_COLOURS else [f"$origin/{by}"]
    return rrb.Spatial3DView(
        origin=f"/{origin}",
        contents=contents,
        name=name,
        overrides=overrides if by != "mean_flow" else dict[Any, Any](),
        eye_controls=rrb.EyeControls3D(
            position=eye,
            look_target=middle,
            eye_up=(0, 0, 1),
        ),
        line_grid=rrb.LineGrid3D(visible=False),
        background=BACKGROUND,
    )


def seen_from(scene: Scene, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place the eye as near as it can be with all grains and the walls around them in view.

    Args:
        scene: Scene.
        positions: Centres of grains [m], shape [n, 3].

    Returns:
        Places [m] of the eye and of the point that it looks at, each of shape [3].
    """
    walls = wall_points(scene, positions)
    reach = scene.grains.reach
    low = np.minimum(positions.min(axis=0) - reach, walls.min(axis=0, initial=np.inf))
    high = np.maximum(positions.max(axis=0) + reach, walls.max(axis=0, initial=-np.inf))
    middle = (low + high) / 2
    above = 0.0 if scene.container.symmetry == "planar" else _SEEN_FROM
    back = np.array([0, -math.cos(above), math.sin(above)])  # from the middle to the eye
    upward = np.array([0, math.sin(above), math.cos(above)])
    # A point is seen if it is no farther from the line of sight than `half` times its distance from the eye along it.
    half, distance = math.tan(_FIELD_OF_VIEW / 2) / _MARGIN, 0.0
    for points, size in ((walls, 0.0), (positions, reach)):
        from_middle = points - middle
        aside = np.maximum(np.abs(from_middle[:, 0]) / _NARROWEST, np.abs(from_middle @ upward)) + size
        distance = max(distance, float((aside / half + from_middle @ back + size).max(initial=0)))
    return middle + distance * back, middle


def log_bars(stream, scene: Scene, fastest: float) -> None:
    """Send the bars of colours of speeds: of grains, with a row for each kind, and of all else.

    Args:
        stream: Stream of rerun.
        scene: Scene of the run.
        fastest: Speed at the upper end of the colours [m/s].
    """
    rr = need_rerun()
    for path, kinds in ((_BAR, [kind.name for kind in scene.grains.kinds]), (_PLAIN, [])):
        bar = colour_bar(kinds, fastest)
        stream.log(path, rr.EncodedImage(contents=bar, media_type="image/png"), static=True)


def above_bar(views, scene: Scene, name: str, *, plain: bool = False):
    """Put views above the bar of their colours.

    Args:
        views: Views of rerun.
        scene: Scene of the run.
        name: Name of the whole.
        plain: Leave out the rows of the kinds of grains.

    Returns:
        Layout of rerun.
    """
    import rerun.blueprint as rrb

    origin = f"/{_PLAIN if plain else _BAR}"
    bar = rrb.Spatial2DView(origin=origin, name="colours", titlebar=False, background=BACKGROUND)
    rows = 1 if plain else max(1, len(scene.grains.kinds))
    return rrb.Vertical(views, bar, row_shares=[10, 1 + 0.25 * (rows - 1)], name=name)


def flow_rate_view(roots: Sequence[str], mean: str = ""):
    """Make a view of W(t), with a legend for several runs.

    Args:
        roots: Entities above the curves.
        mean: Mean of a single run, as text.

    Returns:
        View of rerun.
    """
    import rerun.blueprint as rrb

    contents = [f"+ /{below(root)}flow_rate/**" for root in roots]
    legend = rrb.PlotLegend(visible=len(roots) > 1, corner="RightBottom")
    plot = rrb.archetypes.PlotBackground(color=BACKGROUND)
    name = f"W [g/s]{f', mean over the window: {mean}' if mean else ''}"
    return rrb.TimeSeriesView(origin="/", contents=contents, name=name, plot_legend=legend, background=plot)


def playing(views, duration: float, window: tuple[float, float] | None = None):
    """Make a blueprint that plays a run in _LASTS seconds, again and again.

    Args:
        views: Layout of rerun; there is nothing else in the window.
        duration: Duration of the run [s].
        window: Times [s] that are marked on the clock.

    Returns:
        Blueprint of rerun.
    """
    rr = need_rerun()
    import rerun.blueprint as rrb

    marked: Mapping[str, Any] = {}
    if window is not None:
        ends = (rr.encodings.TimeInt(seconds=end) for end in window)
        marked = {"time_selection": rrb.components.AbsoluteTimeRange(*ends)}
    return rrb.Blueprint(
        views,
        rrb.TimePanel(
            timeline=CLOCK, play_state="playing", loop_mode="all", state="collapsed", **marked,
            playback_speed=duration / _LASTS if duration > 0 else 1.0,
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )  # fmt: skip
