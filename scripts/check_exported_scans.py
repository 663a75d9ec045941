"""Compares exported scans with the input scans moved by poses.json, read by plyfile, laspy, pye57 and pypcd4.

Called by check-exports.sh: check_exported_scans.py RESULT FORMAT FOLDER. The input scans are PLY with
colours, intensities and normals. Nothing here uses code of this project. Points are compared one by one.
"""

import json
import sys
from pathlib import Path

try:
    import numpy as np
    from plyfile import PlyData
except ImportError as error:
    sys.exit(f"skipped: exported scans, as there is no numpy or plyfile ({error})")

XYZ, RGB, NORMAL = ("x", "y", "z"), ("red", "green", "blue"), ("nx", "ny", "nz")


def columns(table, names):
    return np.column_stack([np.asarray(table[n]) for n in names])


def read_ply(path):
    vertex = PlyData.read(path)["vertex"]
    scan = {"xyz": columns(vertex, XYZ).astype(float), "rgb": columns(vertex, RGB)}
    return scan | {"intensity": np.asarray(vertex["intensity"]), "normal": columns(vertex, NORMAL)}


def read_pcd(path):
    try:
        from pypcd4 import PointCloud

        cloud = PointCloud.from_path(str(path)).pc_data
    except ImportError as error:
        print(f"skipped: what pypcd4 reads ({error}); a few lines of numpy read {path.name} instead")
        cloud = rows_of_pcd(path)
    packed = np.ascontiguousarray(cloud["rgb"]).view("<u4")
    rgb = np.column_stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255])
    normal = columns(cloud, ("normal_x", "normal_y", "normal_z"))
    return {"xyz": columns(cloud, XYZ).astype(float), "rgb": rgb, "intensity": cloud["intensity"], "normal": normal}


def rows_of_pcd(path):
    data = path.read_bytes()
    head, body = data.split(b"DATA binary\n", 1)
    lines = dict(line.split(" ", 1) for line in head.decode().splitlines() if " " in line)
    kinds = {"F4": "<f4", "F8": "<f8", "U4": "<u4"}
    fields = zip(lines["FIELDS"].split(), lines["TYPE"].split(), lines["SIZE"].split())
    return np.frombuffer(body, np.dtype([(n, kinds[t + s]) for n, t, s in fields]), int(lines["POINTS"]))


def read_las(path):
    import laspy

    las = laspy.read(path)
    rgb = columns(las, RGB)
    assert np.all(rgb % 257 == 0), "colours of 16 bits are bytes times 257"
    used = {"X", "Y", "Z", "intensity", *RGB}
    for name in set(las.point_format.dimension_names) - used:
        assert np.ptp(np.asarray(las[name]).astype(int)) == 0, f"{name}, which nothing is known of, varies"
    low, high = np.array(las.header.mins), np.array(las.header.maxs)
    xyz = np.array(las.xyz)
    close(np.array([low, high]), np.array([xyz.min(0), xyz.max(0)]), 1.01 * max(las.header.scales), "bounds in the header")
    assert las.header.point_count == len(xyz)
    return {"xyz": xyz, "rgb": rgb // 257, "step": max(las.header.scales), "stored": np.array(las.intensity)}


def close(found, expected, tolerance, what):
    assert found.shape == expected.shape, f"{what}: {found.shape}, not {expected.shape}"
    off = np.abs(found - expected).max()
    assert off <= tolerance, f"{what}: off by {off}, more than {tolerance}"


def equal(found, expected, what):
    assert np.array_equal(found, expected), f"{what} differ at {np.flatnonzero(found != expected)[:5]}"


def compare(found, scan, pose, what):
    turn, shift = pose[:3, :3], pose[:3, 3]
    world = scan["xyz"] @ turn.T + shift
    # Single precision of coordinates relative to the scan's own origin, of a kilometre at most.
    close(found["xyz"], world, found.get("step", 0) * 0.501 + 1e-6 + 6e-8 * extent(scan), f"{what}: xyz")
    equal(found["rgb"], scan["rgb"], f"{what}: colours")
    if "normal" in found:
        close(found["normal"], scan["normal"] @ turn.T, 1e-6, f"{what}: normals")
    if "stored" in found:
        # Shares of one are shares of 65535.
        close(found["stored"].astype(float), scan["intensity"] * 65535.0, 0.51, f"{what}: intensities")
    else:
        equal(found["intensity"], scan["intensity"], f"{what}: intensities")


def extent(scan):
    """Largest coordinate beside the origin of a scan, which is a round number near it."""
    xyz = scan["xyz"]
    size = np.ptp(xyz, axis=0).max()
    return min(np.abs(xyz).max(), 100 * size)


def matrix_of(rotation_wxyz, translation):
    w, x, y, z = rotation_wxyz
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = translation
    return pose


def check_e57(path, scans, read):
    """What a reader shows of the file's scans, and what ASTM E2807 asks their headers to say."""
    import pye57

    # It reads what it knows the type of.
    pye57.e57.SUPPORTED_POINT_FIELDS.update({f"nor:normal{axis}": "f" for axis in "XYZ"})
    file = pye57.E57(str(path))
    assert file.scan_count == len(scans), f"{file.scan_count} scans in {path.name}"
    guids = set()
    for index, entry in enumerate(scans):
        what = f"{path.name}, {entry['name']}"
        scan, pose = read(entry), np.array(entry["world_from_scan"])
        header = file.get_header(index)
        node = header.node
        guids.add(node["guid"].value())
        assert node["name"].value() == entry["name"], node["name"].value()
        raw = file.read_scan_raw(index)
        local = columns(raw, ("cartesianX", "cartesianY", "cartesianZ")).astype(float)
        stated = matrix_of(header.rotation, header.translation)
        assert abs(np.linalg.norm(header.rotation) - 1) < 1e-12, "a unit quaternion"
        close(stated[:3, :3], pose[:3, :3], 1e-9, f"{what}: rotation")
        moved = local @ stated[:3, :3].T + stated[:3, 3]
        found = {"xyz": moved, "intensity": raw["intensity"]}
        found["rgb"] = columns(raw, ("colorRed", "colorGreen", "colorBlue"))
        found["normal"] = columns(raw, ("nor:normalX", "nor:normalY", "nor:normalZ")) @ pose[:3, :3].T
        compare(found, scan, pose, what)
        # As the reader itself moves them.
        shown = file.read_scan(index, ignore_missing_fields=True, colors=True, intensity=True)
        close(columns(shown, ("cartesianX", "cartesianY", "cartesianZ")), moved, 1e-6, f"{what}: read_scan")
        bounds = node["cartesianBounds"]
        for axis, name in enumerate("xyz"):
            ends = [bounds[name + end].value() for end in ("Minimum", "Maximum")]
            close(np.array(ends), np.array([local[:, axis].min(), local[:, axis].max()]), 1e-9, f"{what}: bounds")
        limits = [node["intensityLimits"]["intensity" + end].value() for end in ("Minimum", "Maximum")]
        equal(np.float32(limits), np.array([scan["intensity"].min(), scan["intensity"].max()]), f"{what}: limits")
        for name in ("Red", "Green", "Blue"):
            ends = [node["colorLimits"][f"color{name}{end}"].value() for end in ("Minimum", "Maximum")]
            assert ends == [0, 255], f"{what}: limits of {name} {ends}"
    root = file.root
    guids.add(root["guid"].value())
    assert len(guids) == len(scans) + 1, f"{path.name}: identifiers that are not unique"
    assert root["formatName"].value() == "ASTM E57 3D Imaging Data File"


def main():
    result, kind, folder = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
    document = json.loads((result / "poses.json").read_text())
    cache = {}

    def read(entry):
        return cache.setdefault(entry["file"], read_ply(entry["file"]))

    package = {"las": "laspy", "laz": "lazrs", "e57": "pye57"}.get(kind)
    try:
        __import__(package or "numpy")
    except Exception as error:  # a shared library may be missing, too
        print(f"skipped: {kind} ({package}: {str(error).splitlines()[0]})")
        return
    for number in range(len(document["components"])):
        scans = [s for s in document["scans"] if s.get("component") == number]
        if kind == "e57":
            check_e57(folder / ("scans.e57" if number == 0 else f"scans_{number}.e57"), scans, read)
            continue
        place = folder if number == 0 else folder / f"component_{number}"
        reader = {"ply": read_ply, "pcd": read_pcd, "las": read_las, "laz": read_las}[kind]
        for entry in scans:
            path = place / f"{entry['name']}.{kind}"
            compare(reader(path), read(entry), np.array(entry["world_from_scan"]), path.name)
    placed = sum("component" in s for s in document["scans"])
    # But for the list of what is an export.
    written = [p for p in folder.rglob("*") if p.is_file() and p.name != ".scanweave.exported"]
    assert len(written) == (len(document["components"]) if kind == "e57" else placed), written
    print(f"{kind}: {placed} scans with coordinates, colours, intensities and poses as their sources")


main()
