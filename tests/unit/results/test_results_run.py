"""Attributes of a run in results: those of its row in the index."""

from toy_results import RunDouble, analyse


def test_a_run_has_the_attributes_of_its_row_in_the_index(synthetic):
    class Run(RunDouble):
        def data(self):
            return synthetic.observe(self.point.scene, self.seed, self.entry.outcome)

    made = Run(
        synthetic.point(0, 0.03),
        seed=2,
        outcome="emptied",
        packing_key="aa",
        frame_interval=0.02,
        cache_version=7,
        outdated="the law hertz-mindlin, version 1, now 2",
        suspect="it gained energy",
        ended="2026-03-04T05:06:07+00:00",
    )
    ((run,),) = (point.runs for point in analyse(synthetic.study_of([made.point]), [made]).points)
    assert (run.seed, run.run_key, run.packing_key) == (2, "00000002" * 4, "aa")
    assert (run.outcome, run.suspect, run.ended) == ("emptied", "it gained energy", "2026-03-04T05:06:07+00:00")
    assert (run.backend, run.cache_version, run.device) == ("double", 7, "cpu")
    assert (run.recorded, run.frame_interval) == (True, 0.02)
    assert run.outdated == "the law hertz-mindlin, version 1, now 2"
    assert run.provenance == {"backend": "double"}
