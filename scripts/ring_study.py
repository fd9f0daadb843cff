"""What each open assumption does to the circular robot's way: the table of docs/circular.md.

    python scripts/ring_study.py

Crawls for 10 s with BF at 0.2, 0.4 and 0.6 s, one value changed at a time: some ten minutes on two
cores. A word after it takes only the rows that contain it: ``ring_study.py nodes``.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor

INTERVALS = ("0.2 s", "0.4 s", "0.6 s")
CHANGES = (
    "as shipped",
    *(f"ring.nodes={n}" for n in (8, 16, 64)),
    "ring.contact_refine=1",
    "ring.nodes=64 ring.contact_refine=1",
    *(f"contact.0.friction={mu}" for mu in (0.2, 0.4, 1.2)),
    *(f"ring.hub_mass={m}_g" for m in (0.03, 1.0)),
    *(f"ring.bend_stiffness={k}_N_m/rad" for k in (0.00075, 0.003)),
    "ring.bend_damping=10_ms",
    "ring.first_angle=22.5_deg",
    *(f"coils.end_width={w}_mm" for w in (8, 16)),
    "coils.flow=excess",
    *(f"coils.flow_damping={c}_N_s/m" for c in (1, 100)),
    *(f"coils.limit={b}_mN" for b in (0, 8, 32)),
    *(f"coils.rate_on={r}_mN/s coils.rate_off={r}_mN/s" for r in (300, 600)),
    "ring.width=8_mm",
)


def way(change: str, interval: str) -> float:
    """How far it comes in 10 s [mm]."""
    from flexapod.app.case import load_case
    from flexapod.app.motion_model import assemble_motion, centre
    from flexapod.dynamics.integrator import Options, march

    settings = [f"actuation.interval={interval}"]
    if "=" in change:
        settings += [part.replace("_N_m/rad", " N m/rad") for part in change.split(" ")]
    units = ("_g", "_ms", "_deg", "_mN/s", "_mN", "_mm", "_N_s/m")
    for k, setting in enumerate(settings):
        for unit in units:
            if setting.endswith(unit):
                settings[k] = setting.removesuffix(unit) + " " + unit[1:].replace("_", " ")
                break
    loaded = load_case("ring_crawl", settings)
    motion = assemble_motion(loaded, None, lambda text: None)
    spec = loaded.case.dynamics
    assert spec is not None
    begun = centre(motion.model, motion.state)[0]
    march(
        motion.model,
        motion.state,
        motion.work,
        round(spec.duration / spec.interval),
        Options(spec.interval, spec.safety, spec.time_step),
    )
    return 1e3 * float(centre(motion.model, motion.state)[0] - begun)


def main() -> None:
    """Print the table as it comes, as Markdown."""
    wanted = [c for c in CHANGES if len(sys.argv) < 2 or any(a in c for a in sys.argv[1:])]
    print("| changed | " + " | ".join(INTERVALS) + " |")
    print("| --- |" + " --- |" * len(INTERVALS))
    with ProcessPoolExecutor() as pool:
        rows = [[pool.submit(way, change, t) for t in INTERVALS] for change in wanted]
        for change, row in zip(wanted, rows, strict=True):
            ways = " | ".join(f"{one.result():.0f} mm" for one in row)
            print(f"| {change.replace('_', ' ')} | {ways} |", flush=True)


if __name__ == "__main__":
    main()
