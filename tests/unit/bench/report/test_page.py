"""The report's page: well formed, alone, the same bytes for the same data, and nothing else can get in."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from report_sample import of_many_poses

from bench.measure.view_picture import ViewPicture
from bench.report.html import ReportData, render_report
from tests.unit.bench.report.structure import Structure


def test_every_element_is_closed_and_every_id_is_unique(html):
    structure = Structure(html)
    assert (structure.wrong, structure.open) == ([], [])
    ids = [value for _, name, value in structure.attributes if name == "id"]
    assert len(ids) == len(set(ids))
    links = [value for _, name, value in structure.attributes if name.endswith("href")]
    assert {link[1:] for link in links if link.startswith("#")} <= set(ids)


def test_every_picture_has_a_name_for_those_who_do_not_see_it(html):
    pictures = re.findall(r'<svg [^>]*role="img"[^>]*>', html)
    labels = [re.search(r'aria-label="([^"]+)"', picture) for picture in pictures]
    assert all(labels)
    assert len({label[1] for label in labels}) == len(pictures) == 13


def test_it_needs_no_network_and_runs_no_script(html):
    structure = Structure(html)
    assert not {"script", "iframe", "object", "embed", "link", "form", "base"} & set(structure.tags)
    assert not [a for a in structure.attributes if a[1].startswith("on")]
    loading = {"src", "href", "xlink:href", "data", "action"}
    loaded = [value for _, name, value in structure.attributes if name in loading]
    assert loaded
    assert all(value.startswith(("#", "data:image/")) for value in loaded)
    assert not re.findall(r"url\((?!#)", html)
    assert "@import" not in html


def test_it_forbids_all_but_its_own_pictures_and_style(html):
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', html)
    assert policy.startswith("default-src 'none'; img-src data:; style-src 'unsafe-inline';")


def test_the_same_data_give_the_same_bytes_in_another_process(html, tmp_path):
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from report_sample import SMALL, sample;"
        "from bench.report.html import render_report; print(render_report(sample(size=SMALL)), end='')"
    )
    environment = {"PYTHONHASHSEED": "7", "PATH": "", "HOME": "/nonexistent", "TZ": "Asia/Tokyo"}
    environment |= {"LC_ALL": "C.UTF-8", "MPLCONFIGDIR": str(tmp_path)}
    command = [sys.executable, "-c", code, Path(__file__).parents[3] / "support"]
    root = Path(__file__).parents[4]
    other = subprocess.run(command, capture_output=True, check=True, env=environment, cwd=root)
    assert other.stdout.decode() == html


def test_names_cannot_become_markup(data, results):
    evil = "</style><script>alert(1)</script>\"' onload=x {{ 7*7 }} $\\alpha"
    results["run"] |= {"id": evil, "operator": evil, "station": evil}
    results["deviations"] = [evil]
    results["calibration"]["notes"] = [evil]
    results["states"][0]["state"] = evil
    results["poses"][0] |= {"name": evil}
    results["gates"][0] |= {"name": evil, "limit": evil, "unit": evil}
    views = [ViewPicture(evil, v.image, v.detected, v.reprojected, v.ids) for v in data.views]
    html = render_report(ReportData(results, views, evil))
    structure = Structure(html)
    assert (structure.wrong, structure.open) == ([], [])
    assert "script" not in structure.tags
    (page_rule,) = re.findall(r"@page \{.*?\n\}", html, re.DOTALL)
    assert re.findall(r"Calibration report [^;]*;", page_rule) == [
        'Calibration report ??style??script?alert?1???script??? onload?x ?? 7?7 ?? ??alpha";'
    ]
    assert not [a for a in structure.attributes if a[1].startswith("on")]
    assert "{{ 7*7 }}" in html


@pytest.mark.slow
def test_a_page_of_a_thousand_poses_is_little_larger_than_its_tables(data):
    views = [replace(data.views[i % 3], name=f"pose {i}") for i in range(1000)]
    html = render_report(of_many_poses(views))
    tables = sum(len(table) for table in re.findall(r"<table.*?</table>", html, re.DOTALL))
    assert html.count('<svg class="pose"') == 24
    assert len(html) - tables < 3_000_000
