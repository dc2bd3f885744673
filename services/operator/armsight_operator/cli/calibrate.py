"""`armsight calibrate intrinsics | extrinsics | colours | board`: real cameras, and what they see."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.errors import ConfigError

if TYPE_CHECKING:
    from armsight.calibration import CalibrationFile, KnownCamera
    from armsight.v1.description_pb2 import ArmDescription, Color
    from armsight_operator.calibrate.colours import Learnt
    from armsight_operator.calibrate.extrinsics import Extrinsics
    from armsight_operator.calibrate.footage import Angles, Footage
    from armsight_operator.calibrate.frames import Frame
    from armsight_operator.calibrate.intrinsics import Intrinsics
    from armsight_operator.calibrate.lens import Array, Lens
    from armsight_operator.calibrate.rigid import CameraPose

app = typer.Typer(
    help="Calibrate cameras: lenses, poses and the markers' colours, into calibration.json.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

_NEEDS = "armsight calibrate needs the package opencv-python-headless: `pip install 'armsight-operator[calibrate]'`"

File = Annotated[
    Path, typer.Option("--calibration", metavar="FILE", help="Updated, or made; what else is in it stays.")
]
PictureOut = Annotated[
    Path | None, typer.Option("--picture", metavar="FILE", help="Draw what was found there.", show_default=False)
]
BoardName = Annotated[
    str, typer.Option("--board", metavar="KIND:COLUMNSxROWS", help="charuco by squares, checkerboard by inner corners.")
]
Square = Annotated[float, typer.Option("--square-m", help="Side of a square as it was printed, metres.")]
Marker = Annotated[
    float | None, typer.Option("--marker-m", help="Side of a charuco board's markers, metres.", show_default=False)
]
Dictionary = Annotated[str, typer.Option("--dictionary", help="Of a charuco board's markers, OpenCV's.")]
AnglesFrom = Annotated[str, typer.Option("--angles", help="Where angles are known from: accepted, true or unknown.")]
Description = Annotated[
    Path | None,
    typer.Option(
        "--description",
        metavar="FILE",
        help="A file with the description of the arm, such as `armsight snapshot` writes. [default: the recording's, "
        "else --calibration's]",
        show_default=False,
    ),
]


@app.command()
def board(
    file: Annotated[Path, typer.Argument(help="PNG or PDF to write.")],
    board: BoardName = "charuco:7x5",
    square_m: Square = 0.04,
    marker_m: Marker = 0.03,
    dictionary: Dictionary = "4X4_50",
    dpi: Annotated[int, typer.Option("--dpi", help="Pixels an inch.", min=10, max=2400)] = 300,
) -> None:
    """Draw a board to print, in its true size.

    Print it without scaling, glue it to something flat, and measure the squares.

    Example: armsight calibrate board board.pdf --board charuco:7x5 --square-m 0.04 --marker-m 0.03
    """
    _need_opencv()
    from armsight_operator.calibrate.board import parse_board, write_board

    width, height = write_board(parse_board(board, square_m, marker_m, dictionary), file, dpi)
    print(f"{file}: {width * 1e3:.0f} x {height * 1e3:.0f} mm; print it at 100 % and measure a square")


@app.command()
def intrinsics(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="Folder of pictures, video or recording (.mcap).")],
    camera: Annotated[str, typer.Option("--camera", metavar="NAME", help="Whose lens it is.", show_default=False)],
    board: BoardName,
    square_m: Square,
    marker_m: Marker = None,
    dictionary: Dictionary = "4X4_50",
    every: Annotated[int, typer.Option("--every", help="Look at each so many-th picture only.", min=1)] = 1,
    calibration: File = Path("calibration.json"),
    picture: PictureOut = None,
) -> None:
    """Find a camera's lens from pictures of a board: focal lengths, principal point, distortion.

    Exit code 1 where the pictures don't determine it: nothing is written then, and what to record is said.

    Example: armsight calibrate intrinsics board.mp4 --camera 1 --board checkerboard:9x6 --square-m 0.04
    """
    _need_opencv()
    from armsight.calibration import write_calibration_file
    from armsight.topics import NAME
    from armsight_operator.calibrate import intrinsics as lenses
    from armsight_operator.calibrate.board import parse_board
    from armsight_operator.calibrate.frames import frames
    from armsight_operator.calibrate.lens import message_of
    from armsight_operator.calibrate.views import look

    if not NAME.fullmatch(camera):
        raise ConfigError(
            f"--camera {camera!r} is no name on the bus: use letters, digits, '_', '-' and '.', at most 64"
        )
    known = parse_board(board, square_m, marker_m, dictionary)
    content = _content(calibration)
    seen = look(known, frames(source, camera, every))
    found = lenses.calibrate(seen)
    _print_lens(camera, found, len(seen.views), seen.pictures)
    if picture is not None:
        import numpy as np

        from armsight_operator.calibrate import show

        pixels = np.concatenate([each.view.corners.pixels for each in found.fitted])
        off = np.concatenate([each.residuals for each in found.fitted])
        show.write([show.residuals(seen.sample, pixels, off, f"camera {camera}")], picture)
    of_camera = replace(_camera(content, camera), calibration=message_of(found.lens, camera))
    write_calibration_file(calibration, replace(content, cameras={**content.cameras, camera: of_camera}))
    print(f"written to {calibration}")


@app.command()
def extrinsics(
    source: Annotated[
        Path, typer.Argument(metavar="INPUT", help="Recording (.mcap), or a folder with a folder of pictures a camera.")
    ],
    angles: AnglesFrom = "accepted",
    hold_camera: Annotated[
        list[str] | None,
        typer.Option(
            "--hold-camera", metavar="NAME", help="Its pose is right; may be given again.", show_default=False
        ),
    ] = None,
    description: Description = None,
    poses: Annotated[int, typer.Option("--poses", help="Of the arm, at most; those that differ the most.", min=8)] = 60,
    calibration: File = Path("calibration.json"),
    picture: PictureOut = None,
) -> None:
    """Find where the cameras are, from the arm's own markers at many poses.

    Exit code 1 where the pictures don't determine it: nothing is written then, and what is left open is said.

    Example: armsight calibrate extrinsics poses.mcap --calibration calibration.json
    """
    _need_opencv()
    from armsight.calibration import write_calibration_file
    from armsight_operator.calibrate import extrinsics as where
    from armsight_operator.calibrate import footage, show
    from armsight_operator.calibrate.rigid import message_of_pose

    content = _content(calibration)
    found_in = footage.find_footage(source, _angles(angles), poses)
    lenses = _lenses(content, found_in)
    hold = hold_camera or []
    if unknown := [name for name in hold if name not in found_in.names]:
        raise ConfigError(f"--hold-camera {', '.join(unknown)}: {source} has camera {', '.join(found_in.names)}")
    approximate, arm = _approximate(content, found_in), _description(description, content, found_in)
    measured = where.measure(found_in, arm, lenses)
    found = where.calibrate(measured, approximate, hold)
    _print_poses(found, approximate, found_in.total)
    if picture is not None:
        drawn = zip(measured.samples, found.cameras, strict=True)
        show.write([show.residuals(seen, c.pixels, c.residuals, f"camera {c.name}") for seen, c in drawn], picture)
    cameras = dict(content.cameras)
    for each in found.cameras:
        known = _camera(content, each.name)
        lens = known.calibration or found_in.cameras[each.name].calibration
        cameras[each.name] = replace(known, calibration=lens, pose=message_of_pose(each.pose, each.name))
    write_calibration_file(calibration, replace(content, cameras=cameras, description=content.description or arm))
    print(f"written to {calibration}")


@app.command()
def colours(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="Picture, folder, video or recording (.mcap).")],
    camera: Annotated[str, typer.Option("--camera", metavar="NAME", help="Whose pictures.", show_default=False)],
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at",
            metavar="NAME=COLUMN,ROW",
            help="A place within a marker in the first picture; once for each.",
            show_default=False,
        ),
    ] = None,
    known_order: Annotated[
        bool, typer.Option("--known-order", help="Markers are about where cameras and angles of a recording put them.")
    ] = False,
    angles: AnglesFrom = "accepted",
    description: Description = None,
    calibration: File = Path("calibration.json"),
    picture: PictureOut = None,
) -> None:
    """Learn the markers' colours from what a camera sees.

    Exit code 1 where vision could not tell them apart, or something else has a marker's colour: nothing is written
    then.

    Example: armsight calibrate colours view.png --camera 1 --at red=412,300 --at blue=380,420

    Example: armsight calibrate colours poses.mcap --camera 1 --known-order
    """
    _need_opencv()
    from armsight.calibration import recoloured, write_calibration_file
    from armsight.v1.description_pb2 import Color
    from armsight_operator.calibrate import colours as learning
    from armsight_operator.calibrate import show

    if bool(at) == known_order:
        raise ConfigError("give either --at for each marker, or --known-order")
    content = _content(calibration)
    if known_order:
        frame, found, own = _by_order(source, camera, angles, description, content)
    else:
        frame, found, own = _by_places(source, camera, at or [])
    known = {
        name: np_colour
        for name, colour in content.colours.items()
        if name not in found and (np_colour := _as_array(colour)).sum() > 0
    }
    every = {**known, **found}
    if picture is not None:
        show.write([show.colours(frame.rgb, learning.taken(frame.rgb, every), every)], picture)
    learning.check_apart(every)
    learning.check_background(frame.rgb, every, {name: learnt.mask for name, learnt in own.items()})
    for name, colour in found.items():
        hue, saturation = learning.hue_and_saturation(colour)
        channels = ", ".join(f"{part:.3f}" for part in colour)
        print(f"{name}: {channels}; hue {round(_degrees(float(hue))) % 360}°, saturation {float(saturation):.2f}")
    written = {name: Color(red=c[0], green=c[1], blue=c[2]) for name, c in found.items()}
    content = replace(content, colours={**content.colours, **written})
    # twice in the file: vision on files goes by the description alone
    arm = content.description and recoloured(content.description, content)
    write_calibration_file(calibration, replace(content, description=arm))
    print(f"written to {calibration}")


def _need_opencv() -> None:
    import importlib.util

    if importlib.util.find_spec("cv2") is None:
        raise ConfigError(_NEEDS)


def _content(path: Path) -> "CalibrationFile":
    """What the file has in it already; nothing where there is none yet."""
    from armsight.calibration import CalibrationFile, read_calibration_file

    return read_calibration_file(path) if path.exists() else CalibrationFile()


def _camera(content: "CalibrationFile", name: str) -> "KnownCamera":
    from armsight.calibration import KnownCamera

    return content.cameras.get(name, KnownCamera())


def _angles(text: str) -> "Angles":
    from armsight_operator.calibrate.footage import Angles

    try:
        return Angles(text)
    except ValueError:
        raise ConfigError(f"--angles {text!r} is none of {', '.join(Angles)}") from None


def _lenses(content: "CalibrationFile", footage: "Footage") -> "dict[str, Lens]":
    from armsight_operator.calibrate.lens import lens_of

    lenses = {}
    for name in footage.names:
        recorded = footage.cameras.get(name)
        calibration = _camera(content, name).calibration or (recorded.calibration if recorded else None)
        if calibration is None:
            raise ConfigError(f"the lens of camera {name} is not known: `armsight calibrate intrinsics` finds it")
        lenses[name] = lens_of(calibration, name)
    return lenses


def _approximate(content: "CalibrationFile", footage: "Footage") -> "dict[str, CameraPose]":
    from armsight_operator.calibrate.rigid import pose_of

    poses = {}
    for name in footage.names:
        recorded = footage.cameras.get(name)
        pose = _camera(content, name).pose or (recorded.pose if recorded else None)
        if pose is not None:
            poses[name] = pose_of(pose, name)
    return poses


def _description(path: Path | None, content: "CalibrationFile", footage: "Footage") -> "ArmDescription":
    """With the file's colours, where it has any."""
    from armsight.calibration import read_calibration_file, recoloured

    found = read_calibration_file(path).description if path is not None else footage.description or content.description
    if found is None:
        raise ConfigError(
            f"{path or 'neither the recording nor the file'} has no description of the arm: give --description"
        )
    return recoloured(found, content)


def _by_places(source: Path, camera: str, at: list[str]) -> "tuple[Frame, dict[str, Array], dict[str, Learnt]]":
    import re

    from armsight.topics import NAME
    from armsight_operator.calibrate import colours as learning
    from armsight_operator.calibrate.frames import frames

    places: dict[str, tuple[int, int]] = {}
    for text in at:
        match = re.fullmatch(r"(.+)=(\d{1,5}),(\d{1,5})", text)
        if match is None or not NAME.fullmatch(match[1]):
            raise ConfigError(f"--at {text!r} is no NAME=COLUMN,ROW")
        places[match[1]] = int(match[2]), int(match[3])
    frame = next(frames(source, camera))
    own = {name: learning.learn_at(frame.rgb, *place) for name, place in places.items()}
    return frame, {name: learnt.colour for name, learnt in own.items()}, own


def _by_order(
    source: Path, camera: str, angles: str, description: Path | None, content: "CalibrationFile"
) -> "tuple[Frame, dict[str, Array], dict[str, Learnt]]":
    from armsight_operator.calibrate import colours as learning
    from armsight_operator.calibrate import expected, footage
    from armsight_operator.calibrate.frames import Frame

    found_in = footage.find_footage(source, _angles(angles), 20)
    if camera not in found_in.names or found_in.instants[0].joints is None:
        raise ConfigError(f"--known-order needs a recording with pictures of camera {camera} and angles")
    approximate = _approximate(content, found_in)
    if camera not in approximate:
        raise ConfigError(f"no pose of camera {camera} is known, not even about: put it into the file, or record it")
    arm, lens = _description(description, content, found_in), _lenses(content, found_in)[camera]
    learnt: dict[str, list[Learnt]] = {}
    best: tuple[Frame, dict[str, Learnt]] | None = None
    for index, name, rgb in found_in.pictures():
        if name != camera:
            continue
        places, radii = expected.places(arm, lens, approximate[camera], found_in.instants[index].joints or {})
        here = learning.learn_near(rgb, places, radii)
        for marker, each in here.items():
            learnt.setdefault(marker, []).append(each)
        if best is None or len(here) > len(best[1]):
            best = Frame(f"picture {index}", rgb), here
    assert best is not None
    found = learning.agreed(learnt, [marker.name for marker in arm.markers])
    return best[0], found, best[1]


def _as_array(colour: "Color") -> "Array":
    import numpy as np

    return np.array([colour.red, colour.green, colour.blue])


def _print_lens(camera: str, found: "Intrinsics", views: int, pictures: int) -> None:
    from armsight_operator.calibrate.intrinsics import NAMES

    lens = found.lens
    print(f"camera {camera}: the board is in {views} of {pictures} pictures, {len(found.fitted)} were used")
    if found.rejected:
        print(f"left out, agree with no lens: {', '.join(found.rejected)}")
    print(f"residuals {found.rms_px:.3f} px RMS; corners in {found.covered:.0%} of the picture")
    values = [*lens.focal, *lens.centre, *lens.distortion]
    for name, value, sigma in zip(NAMES, values, found.sigma, strict=True):
        digits = 2 if name in NAMES[:4] else 5
        known = f" ± {sigma:.{digits}f}" if sigma > 0 else "  (not needed)"
        print(f"{name}  {value:.{digits}f}{known}")
    print("worst: " + ", ".join(f"{each.view.name} {each.rms_px:.2f} px" for each in found.worst()))


def _print_poses(found: "Extrinsics", approximate: "Mapping[str, CameraPose]", total: int) -> None:
    import numpy as np

    print(f"{found.poses} poses of the arm, of {total}")
    for camera in found.cameras:
        line = (
            f"camera {camera.name}: {camera.used} centres, {camera.left_out} left out; residuals {camera.rms_px:.3f} "
            f"px RMS, {camera.at_markers_m * 1e3:.1f} mm at the markers; "
        )
        if camera.held:
            print(f"{line}held")
            continue
        position_mm, direction_mrad = camera.position_sigma_m * 1e3, camera.direction_sigma_rad * 1e3
        line += f"position ± {position_mm:.1f} mm, direction ± {direction_mrad:.2f} mrad"
        if (before := approximate.get(camera.name)) is not None:
            shift = float(np.linalg.norm(camera.pose.position - before.position))
            turned = (float(np.trace(camera.pose.rotation.T @ before.rotation)) - 1) / 2
            line += (
                f"; {shift:.3f} m and {_degrees(float(np.arccos(np.clip(turned, -1, 1)))):.2f}° from where it was said"
            )
        print(line)
    if found.twins:
        print(
            f"{found.twins} poses have a twin: other angles that put every marker at the same place; cameras are the "
            "same for both"
        )


def _degrees(radians: float) -> float:
    import math

    return math.degrees(radians)
