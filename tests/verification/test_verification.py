"""Every case of `labbook verify` on every backend that is there, and most in both precisions."""

from collections.abc import Sequence

import pytest
from platforms import Bundled, platforms, specialised, where

from labbook.backend import Unsupported
from labbook.checks.verify import clumps, mesh, mesh_rods, moving
from labbook.checks.verify.case import Case, Criterion, judge
from labbook.checks.verify.cases import CASES, select_cases
from labbook.checks.verify.materials import EVERY_LAW
from labbook.checks.verify.platform import Platform, require

IN_ONE = {
    # of the law at the other; laws without friction, and each law's functions, are compared in both precisions
    "restitution-linear",
    "gas-energy-linear",
    "contact-time",
    "unlike-restitution-hertz-mindlin",
    "unlike-restitution-linear",
    "unlike-impact-hertz-mindlin",
    "unlike-stack-hertz-mindlin",
    "unlike-momenta-hertz-mindlin",
    "unlike-momenta-linear",
    "unlike-materials-hertz-mindlin",
    "unlike-materials-linear",
    # of three laws no other case is in this shape; test_dem_laws and the other two are in both
    *(f"{case}-{law}" for law in EVERY_LAW for case in ("impacts", "sliding")),
    # contacts with meshes are found in double in both
    # of the walls at others: turntable-round; the hopper and rim-without-slip; rods of the contract
    "turntable",
    "edge-roll-off",
    "rim-roll-off",
    "edge-without-slip",
    *(case.name for case in (*mesh.CASES, *mesh_rods.CASES, *moving.CASES)),
    "rolling-round-a-cylinder",
    "rod-landing",
    "rod-over-rim",
    "rod-on-turntable",
    "rod-without-length",
    "rod-on-two-rim-points",
    "rod-rocks-on-rim",
    "rod-on-turning-rim",
    "turning-rim-impact",
    "rods-turned",
    "rods-mirrored",
    # of mixtures at unlike-impact-linear and unlike-stack-linear
    "renumbering-mixture",
    # powers are computed on the host from what energy-cycle reads in both
    *("energy-slide", "energy-parts"),
    # a million steps; rolling-spring has springs in both
    "rolling-spring-rests",
    "rolling-spring-pyramid",
    # long runs of what renumbering, mirror, scale-invariance, resting-bed and rods of the contract see in both
    "resting-mixture",
    "resting-pile",
    "resting-bed-round",
    "flow-outlet",
    "flow-friction",
    "flow-height",
}
"""Cases that a backend takes in its first precision only, on a processor: they need kernels that no other case needs,
or they are long. Each feature is there in the other precision as well, in the cases that are named."""
ON_A_GPU = {"flow-outlet", "flow-friction", "turntable", "turntable-round", "resting-bed-round"}
"""Of the GPU backend only where it is quick. On a processor it takes flow-height, and test_compare_backends has it
beside the CPU backend, which takes all flows and beds; turntables are two million launches for one grain: there
test_reference_rods has rods over a turning bottom beside the reference."""

LONG_BY_THE_REFERENCE = {
    *("rod-without-length", "turning-rim-impact", "energy-cycle-hertz-mindlin", "energy-cycle-linear"),
    *("unlike-stack-hertz-mindlin", "unlike-stack-linear", "energy-slide", "energy-parts"),
    *("mesh-order", "lip-slot", "lip-hole"),
    *("clump-free-top", "clump-landing", "clump-momenta", "clump-bed-at-rest", "clump-of-one-sphere"),
}
"""Cases that plain Python takes more than five seconds for: in the ring."""
LONG = {
    *("resting-bed-round", "resting-mixture", "flow-friction", "rolling-spring", "rolling-spring-pyramid"),
    # test_contract_rolling has rolling springs beside the reference
    "rolling-spring-rests",
    # flow-height and the contract have the outlet
    *("rolling-spring-mobilised", "flow-outlet"),
    # test_dem_one_source compiles the functions of these laws; kernels call them as those of hertz-mindlin
    *(f"{case}-hertz-{of}" for of in ("lammps", "liggghts", "printed") for case in ("impacts", "sliding")),
    # a hundred turns, and balances at every step; test_numba_mesh has a box that does all of this beside the reference
    *("moving-turntable", "moving-balance"),
    # kernels of rods at meshes are compiled for these only; test_dem_mesh_rods has their contacts
    *(case.name for case in mesh_rods.CASES),
}
"""Cases that take twenty seconds and more anywhere on a processor, with kernels of their own or many steps."""
BY_THE_REFERENCE = {
    *("restitution-at-study-step", "contact-time", "pair-momenta", "rod-impact", "rod-without-length"),
    *("turning-rim-impact", "energy-cycle-hertz-mindlin", "energy-cycle-linear", "energy-impact"),
    *("energy-slide", "energy-parts", "mesh-order", "mesh-valley", "mesh-round", "lip-slot", "lip-hole"),
    *("unlike-restitution-hertz-mindlin", "unlike-restitution-linear", "unlike-impact-hertz-mindlin"),
    *("unlike-impact-linear", "unlike-momenta-hertz-mindlin", "unlike-momenta-linear"),
    *("unlike-stack-hertz-mindlin", "unlike-stack-linear"),
    *("unlike-materials-hertz-mindlin", "unlike-materials-linear"),
    *("unlike-materials-oblique-hertz-mindlin", "unlike-materials-oblique-linear"),
    *(case.name for case in clumps.CASES),
}
"""Cases that plain Python takes in seconds. In others the reference stands beside the backends: test_reference_rods,
test_reference_spheres, and the whole contract."""


def left_out(case: Case, platform: Bundled) -> bool:
    if platform.part < 1:
        return case.name not in BY_THE_REFERENCE
    warp = platform.device == "cpu" and platform.backend.capabilities.name == "warp"
    return (platform.second and case.name in IN_ONE) or (warp and case.name in ON_A_GPU)


def checks(among: Sequence[Bundled]):
    """Every case on every platform that takes it."""
    for platform in among:
        here = where(platform, slow=pytest.mark.slow)
        for case in CASES:
            if not left_out(case, platform):
                long = case.name in LONG
                if platform.device == "cpu":
                    long |= platform.part < 1 and case.name in LONG_BY_THE_REFERENCE
                    # every step is a launch or more there; its GPU takes all, and the contract is quick on both
                    long |= platform.backend.capabilities.name == "warp"
                    # kernels of the second precision are compiled for these; test_reference_spheres has them too
                    long |= platform.second
                marks = [*here.marks, *([pytest.mark.slow] if case.slow else []), *([pytest.mark.ring] if long else [])]
                yield pytest.param(case, platform, id=f"{case.name}-{here.id}", marks=marks)


def faults(case: Case, platform: Platform) -> str:
    """What of a case does not hold on a platform."""
    bad = [v for v in judge(case, platform) if v.result == "failed"]
    return "\n".join(f"{v.measure}: {v.note or f'{v.error:.3g} > {v.limit:.3g} {v.unit}'}" for v in bad)


@pytest.mark.parametrize(("case", "platform"), list(checks(platforms())))
def test_case(case, platform):
    assert not faults(case, platform)


@pytest.mark.ring
@pytest.mark.parametrize(("case", "platform"), list(checks([platform for platform in platforms() if platform.wide])))
def test_case_on_the_kernels_of_users(case, platform):
    """Each compiled for the scene, as by `labbook verify`; test_contract_kernels holds them against the shared ones."""
    assert not faults(case, specialised(platform))


def test_what_is_left_out_is_known():
    names = IN_ONE | ON_A_GPU | BY_THE_REFERENCE | LONG | LONG_BY_THE_REFERENCE
    assert {case.name for case in CASES} >= names


def test_there_is_an_backend_to_check():
    assert platforms()


def test_names_are_unique_and_chosen_by_their_beginning():
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    assert [case.name for case in select_cases(["restitution-lin"])] == ["restitution-linear"]
    assert select_cases([]) == list(CASES)
    with pytest.raises(KeyError):
        select_cases(["no-such-case"])


def invented(run, **measures: Criterion) -> Case:
    return Case(name="invented", statement="", source="", measures=measures, run=run)


@pytest.mark.parametrize(
    ("error", "limits", "result"),
    [
        (0.9, {"double": 1.0}, "passed"),
        (1.1, {"double": 1.0}, "failed"),
        (float("nan"), {"double": 1.0}, "failed"),
        (1.1, {}, "reported"),
    ],
)
def test_verdicts(error, limits, result):
    (verdict,) = judge(invented(lambda _: {"a": error}, a=Criterion(limits)), platforms()[0])
    assert verdict.result == result


def test_what_cannot_be_measured_has_failed():
    def run(_):
        require(False, "nothing moved")
        return {"a": 0.0}

    (verdict,) = judge(invented(run, a=Criterion({})), platforms()[0])
    assert verdict.result == "failed"
    assert verdict.note == "nothing moved"


@pytest.mark.parametrize("key", ["grains.shape", "container", "numerics.precision"])
def test_a_scene_that_the_backend_lacks_is_unsupported_and_other_lacks_are_errors(key):
    def run(_):
        raise Unsupported(key, "it has none")

    case = invented(run, a=Criterion({"double": 1}))
    if key == "numerics.precision":
        with pytest.raises(Unsupported):
            judge(case, platforms()[0])
        return
    (verdict,) = judge(case, platforms()[0])
    assert (verdict.result, verdict.note) == ("unsupported", "it has none")


def test_a_case_must_measure_what_it_says_and_state_a_limit():
    with pytest.raises(ValueError, match="measures"):
        judge(invented(lambda _: {"b": 0.0}, a=Criterion({"double": 1})), platforms()[0])
    with pytest.raises(ValueError, match="no limit"):
        judge(invented(lambda _: {"a": 0.0}, a=Criterion({"other": 1})), platforms()[0])
