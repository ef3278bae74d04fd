"""The picker in Firefox: where it has no WebGL, with the rasterizer's pictures."""

from __future__ import annotations

import pytest
from firefox import Firefox, find_firefox
from pick_visit import visiting

from splatmorph.runs.request import fit_run
from splatmorph.runs.settings import Finding


@pytest.mark.long
def test_twelve_features_clicked_saved_and_morphed(tmp_path):
    program = find_firefox()
    if program is None:
        pytest.skip("no Firefox here (apt-get install firefox-esr)")
    browser = Firefox(program, 1300, 760)
    try:
        with visiting(browser, tmp_path, "ines", "otto") as visit:
            browser.wait("pane0.dataset.drawn === 'still'")
            names = visit.pick_features()
            visit.turn(0.0)
            browser.wait("picker.legs[0].ready")
            browser.evaluate("picker.setTime(0.5).then(() => 0)")
            browser.wait("pane1.dataset.drawn === 'still'")
            assert browser.screenshot()[100:600, 520:900].std() > 20
            browser.evaluate("picker.save().then(() => 0)")
    finally:
        browser.close()
    visit.saved(names)
    run = fit_run(*visit.paths, out=tmp_path / "run", finding=Finding(auto=False))
    assert max(run.legs[0].report["errors"].values()) < 1e-3
