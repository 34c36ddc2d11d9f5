import base64
import hashlib
import json
import re
import shutil

import numpy as np
import pytest

from treadlight import store
from treadlight.cli import main
from treadlight.planning.code import code_digest

PROFILES = ["captures/a/profile.zarr", "captures/b/profile.zarr/zarr.json"]


def report(results, captures="ab", **more):
    out = results / "tires/t7/report.html"
    arguments = ["report", "t7", "--wear", results / "tires/t7/wear.zarr"]
    arguments += ["--trend", results / "tires/t7/trend.csv", "--out", out, "--profiles"]
    arguments += [results / f"captures/{name}/profile.zarr/zarr.json" for name in captures]
    arguments += ["--quality", *(results / f"captures/{name}/quality.json" for name in captures)]
    for name, value in more.items():
        arguments += [f"--{name}", *value]
    assert main([str(a) for a in arguments]) == 0
    return out.read_text(encoding="utf-8")


def index(results):
    arguments = ["index", "--results", results, "--archive-state", results / "archive.json"]
    arguments += ["--out", results / "index.html", "--products", results / "products.json"]
    assert main([str(a) for a in arguments]) == 0
    products = json.loads((results / "products.json").read_text())
    return (results / "index.html").read_text(encoding="utf-8"), products


def change_state(results, **changes):
    path = results / "archive.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}), encoding="utf-8")


def page_data(text):
    """What the page's script gets, as Python values."""
    shown = text.partition('id="page-data">')[2].partition("</script>")[0]
    return json.loads(shown)


def unpacked(layer, name):
    counts = np.frombuffer(base64.b64decode(layer[name]), "<i2").astype(float)
    counts[counts == -32768] = np.nan
    return counts.reshape(layer["theta_deg"]["count"], layer["z_mm"]["count"]) / 1000


def test_a_report_holds_maps_and_trend_and_is_the_same_twice(results):
    facts = [json.dumps({"size": "215/70R16", "outboard": "+z"})]
    text = report(results, calibrations=["cal", "cal"], facts=facts)
    assert "215/70R16" in text
    assert "a: Odd a." in text
    assert text.count('data-plot="map"') == 3
    assert report(results, calibrations=["cal", "cal"], facts=facts) == text
    provenance = json.loads((results / "tires/t7/report.html.provenance.json").read_text())
    assert len(provenance["inputs"]) == 6


def test_later_heights_stand_in_the_first_captures_frame(results):
    first, second = page_data(report(results))["layers"]
    difference = unpacked(first, "height") - unpacked(second, "height")
    assert np.nanmax(np.abs(difference - 0.1)) < 2e-3
    assert first["wear"] is None


def test_a_report_shows_how_far_the_rays_pass_each_led(results):
    path = results / "calibrations/cal/leds.json"
    rays = [
        {"led": led, "ball": ball, "pixel": [1, 2], "distance_mm": 0.1 * ball, "used": ball < 4}
        for led in range(2)
        for ball in range(5)
    ]
    path.write_text(json.dumps({"leds": [{"led": 0}, {"led": 1}], "rays": rays}))
    text = report(results, **{"calibration-files": [path]})
    assert "0.15 mm in the mean of 8 rays. 2 more" in text
    for nothing in ({"leds": None}, {"refused": "No board."}):
        path.write_text(json.dumps(nothing))
        assert "LEDs" not in report(results, **{"calibration-files": [path]})


def test_one_capture_gives_a_report_without_wear(results):
    one = store.open_store(results / "tires/t7/wear.zarr").isel(capture=slice(0, 1)).load()
    store.write_store(results / "tires/t7/wear.zarr", one, title="W", source="t7")
    rows = (results / "tires/t7/trend.csv").read_text().splitlines()[:3]
    store.write_text(results / "tires/t7/trend.csv", "\n".join(rows) + "\n")
    text = report(results, "a")
    assert text.count('data-plot="map"') == 1
    assert "Irregular wear" not in text


def test_a_refused_capture_is_told_and_the_others_are_drawn(results, refuse):
    refuse("captures/b/profile.zarr", "captures/b/quality.json", "tires/t7/wear.zarr")
    text = report(results)
    assert "b was refused: led/3.png: cannot be decoded." in text
    assert "There is no wear:" in text
    assert text.count('data-map="height"') == 1


def test_a_tire_without_any_usable_capture_still_has_a_report(results, refuse):
    for name in "ab":
        refuse(f"captures/{name}/profile.zarr", f"captures/{name}/quality.json")
    refuse("tires/t7/wear.zarr")
    (results / "tires/t7/trend.csv").write_text("tire,capture,region\n")
    text = report(results)
    assert text.count("was refused") == 2
    assert "<script" not in text


def test_lists_of_different_length_are_refused_with_a_sentence(results, capsys):
    arguments = [
        "report",
        "t7",
        "--wear",
        "w",
        "--trend",
        "t",
        "--out",
        "o",
        "--profiles",
        "a",
        "b",
    ]
    assert main([*arguments, "--quality", "q"]) == 2
    assert "Give one quality.json per profile" in capsys.readouterr().err
    assert main([*arguments, "--quality", "q", "r", "--calibrations", "c"]) == 2
    assert "one calibration per profile" in capsys.readouterr().err


def test_the_index_links_the_report_and_shows_key_numbers(results):
    text, products = index(results)
    assert '<a href="tires/t7/report.html">' in text
    assert "7.90\u202fmm" in text
    assert "data:image/png" in text
    assert "a: Late calibration." in text
    assert "nothing refused" in text
    assert products["refused"] == {}


def test_products_hold_the_sha256_of_every_contract_file(results):
    (results / "captures/a/profile.zarr/.hidden").write_text("x")
    (results / "captures/a/profile.zarr.provenance.json").write_text("{}")
    (results / "logs").mkdir()
    (results / "logs/a.log").write_text("x")
    _, products = index(results)
    files = products["files"]
    for name, digest in files.items():
        assert hashlib.sha256((results / name).read_bytes()).hexdigest() == digest
    folders = {name.split("/zarr.json")[0] for name in files if name.endswith("zarr.json")}
    assert "captures/a/photometric.zarr/fov00" in folders
    assert "calibrations/cal/illumination.zarr" in folders
    assert {"index.html", "tires/t7/trend.csv", "captures/b/quality.json"} <= set(files)
    assert not [n for n in files if re.search(r"hidden|provenance|logs|products|archive.json", n)]


def test_refused_captures_reach_the_index_and_products(results, refuse):
    refuse("captures/b/profile.zarr", "captures/b/quality.json")
    change_state(results, refused={"t9": "capture.yaml: 'kind' is <None>."})
    text, products = index(results)
    assert products["refused"] == {
        "b": "led/3.png: cannot be decoded.",
        "t9": "capture.yaml: 'kind' is <None>.",
    }
    assert "b was refused: led/3.png: cannot be decoded." in text
    assert "t9 was refused" in text
    assert "<None>" not in text


def test_a_refused_calibration_is_said_on_the_index(results, refuse):
    refuse("calibrations/cal/calibration.json", reason="No board was found.")
    text, _ = index(results)
    assert "cal was refused: No board was found." in text


def test_an_index_of_unfinished_results_shows_what_there_is(results):
    shutil.rmtree(results / "tires")
    shutil.rmtree(results / "captures")
    shutil.rmtree(results / "calibrations")
    text, products = index(results)
    assert "not made yet" in text
    assert "<a " not in text
    assert list(products["files"]) == ["index.html"]


def test_status_is_0_while_nothing_is_refused(results, capsys):
    assert main(["status", str(results)]) == 0
    said = capsys.readouterr().out
    assert "Tire t7: 2 captures" in said
    assert "a (calibration cal)" in said
    assert "Warning: Late calibration." in said
    assert "nothing is refused" in said


@pytest.mark.parametrize(
    "product",
    ["captures/b/laser.zarr", "captures/b/quality.json", "captures/b/photometric.zarr/fov00"],
)
def test_status_is_1_while_a_product_is_refused(results, refuse, capsys, product):
    refuse(product)
    assert main(["status", str(results)]) == 1
    said = capsys.readouterr().out
    assert "b: led/3.png: cannot be decoded." in said
    assert "b (calibration cal), refused" in said


def test_status_is_1_while_a_capture_was_left_out(results, capsys):
    change_state(results, refused={"t9": "Its capture.yaml is empty."})
    assert main(["status", str(results)]) == 1
    assert "t9: Its capture.yaml is empty." in capsys.readouterr().out


def test_status_names_what_is_missing(results, capsys):
    shutil.rmtree(results / "captures/a/photometric.zarr")
    (results / "captures/b/quality.json").unlink()
    assert main(["status", str(results)]) == 0
    said = capsys.readouterr().out
    assert "Missing: 2 products" in said
    assert "captures/a/photometric.zarr/fov00" in said
    assert "captures/b/quality.json" in said


def test_views_that_a_capture_no_longer_has_are_no_products(results):
    store.write_json(results / "captures/a/inventory.json", {"views": []})
    (results / "captures/b/inventory.json").unlink()
    files = index(results)[1]["files"]
    assert not [name for name in files if name.startswith("captures/a/photometric.zarr")]
    assert [name for name in files if name.startswith("captures/b/photometric.zarr/fov00")]


def test_status_tells_what_is_stale_and_why(results, capsys):
    profile, out = results / "captures/a/profile.zarr", results / "exports/a/height.png"
    assert main(["export", "png", str(profile), str(out), "--code", "of-then"]) == 0
    main(["status", str(results)])
    assert "exports/a/height.png: made by other code" in capsys.readouterr().out
    now = code_digest("treadlight.commands.export")
    assert main(["export", "png", str(profile), str(out), "--code", now]) == 0
    main(["status", str(results)])
    assert "Stale" not in capsys.readouterr().out
    shutil.rmtree(profile)
    shutil.copytree(results / "captures/b/profile.zarr", profile)
    main(["status", str(results)])
    assert "exports/a/height.png: captures/a/profile.zarr has changed" in capsys.readouterr().out


def test_status_without_results_names_the_remedy(tmp_path, capsys):
    assert main(["status", str(tmp_path)]) == 2
    assert "Run snakemake first" in capsys.readouterr().err
