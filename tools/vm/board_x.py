# SPDX-License-Identifier: Apache-2.0
"""Board x: Debian's kernel for PCs, booted with four cores and the line of `lithe tune`, with four, and with one."""

import hashlib
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

from vm import debian, machine
from vm.machine import BIN, HOME, LITHE, ROOT, Cargo, Kernel, Step, changed
from vm.verdict import Skipped, Verdict, document

PACKAGE = "linux-image-amd64"
NAMES = ("board_x.sh", "board_x_partition.sh", "board_x_one_core.sh")
SCRIPT, PARTITION, ONE_CORE = (Path(__file__).with_name(name) for name in NAMES)
CORES = "1,3"  # the robot's
DOCTOR = ROOT / "tests/system/host/doctor_expected.sh"  # every item of the doctor once more, read by a shell script
ITEMS = 39
REFUSED = {"refused-plan": 2, "refused-shield": 1}  # steps that must end so
# An interrupt that does not come is not moved away at run time: the kernel moves it when it comes.
QUIET = "irqaffinity=0"
PROFILES = ROOT / "host/boards"  # `lithe tune` looks for them beside its own folder
GRUB = """# If you change this file, run 'update-grub' afterwards to update
# /boot/grub/grub.cfg.
GRUB_DEFAULT=0
GRUB_TIMEOUT=5
GRUB_DISTRIBUTOR=`lsb_release -i -s 2> /dev/null || echo Debian`
GRUB_CMDLINE_LINUX_DEFAULT="quiet"
GRUB_CMDLINE_LINUX=""
"""
# As update-grub reads them.
READ_GRUB = """set -e
. "$0/etc/default/grub"
for each in "$0"/etc/default/grub.d/*.cfg; do [ ! -e "$each" ] || . "$each"; done
echo "$GRUB_CMDLINE_LINUX $GRUB_CMDLINE_LINUX_DEFAULT"
"""
# Patient with an emulated machine; without a law, since there is no compiler.
PATIENCE = {
    "compile_s = 20 ": "compile_s = 200 ",
    "rate_hz = 1000 ": "rate_hz = 250 ",
    'release = "spin"': 'release = "sleep"',
    "late_ticks_to_stop = 20 ": "late_ticks_to_stop = 10000 ",
    "watchdog_s = 0.2 ": "watchdog_s = 10.0 ",
    "stale_after_s = 0.25 ": "stale_after_s = 2.0 ",
    "safe_kp_nm_rad = 1.0 ": "safe_kp_nm_rad = 0.5 ",
    "ideal = false ": "ideal = true ",
}
LAW = {'law = "../laws/pd.cpp"': ""}


def kernel_of(package: str, architecture: machine.Architecture, cache: Path) -> Kernel:
    """The kernel in the cache, downloaded if there is none; a reason to skip if QEMU is missing."""
    if lacking := machine.missing_tools(architecture):
        raise Skipped(f"sudo apt-get install -y --no-install-recommends {' '.join(lacking)}")
    if machine.find_kernel(cache) is None:
        debian.get_kernel(package, architecture.debian, cache)
    found = machine.find_kernel(cache)
    if found is None:
        raise debian.Trouble(f"no kernel in what came for {package}: {cache}")
    return found


def need(names: tuple[str, ...], folder: Path = BIN) -> tuple[Path, ...]:
    """The programs; an error that names those that are not built."""
    if missing := [name for name in names if not (folder / name).exists()]:
        raise debian.Trouble(f"not in {folder}: {', '.join(missing)}; make release, or set LITHE_BIN_DIR")
    return tuple(folder / name for name in names)


def make_image(root: Path, kernel: Kernel) -> None:
    """The files of a Debian system that has GRUB, as far as `lithe tune` looks at them."""
    shutil.rmtree(root, ignore_errors=True)
    for folder in ("etc/default/grub.d", "etc/sysctl.d", "etc/security/limits.d", "var/lib", "boot"):
        (root / folder).mkdir(parents=True)
    (root / "etc/default/grub").write_text(GRUB)
    (root / "etc/debian_version").write_text("12.0\n")
    (root / "boot" / kernel.config.name).write_bytes(kernel.config.read_bytes())


def content(root: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {str(each.relative_to(root)): each.read_bytes() for each in sorted(root.rglob("*")) if each.is_file()}


def tune(verb: str, root: Path, *words: str) -> dict[str, Any]:
    """`lithe tune` on an image; its document."""
    command = [str(BIN / "lithe"), "--json", "tune", verb, "--root", str(root), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise debian.Trouble(f"{' '.join(command)} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    told: dict[str, Any] = json.loads(done.stdout)
    return told


def boot_line(root: Path) -> str:
    """What GRUB would give to the kernel."""
    done = subprocess.run(["sh", "-c", READ_GRUB, root], capture_output=True, text=True, check=True)
    return " ".join(done.stdout.split())


def states(diagnosis: dict[str, Any]) -> dict[str, str]:
    """State of each of the doctor's items."""
    return {item["id"]: item["state"] for item in diagnosis.get("items", [])}


def expect_items(verdict: Verdict, name: str, diagnosis: dict[str, Any], script: str) -> None:
    """Each item of a diagnosis is as the shell script says: a line `ID STATE` for each."""
    wanted = dict(line.split() for line in script.splitlines() if len(line.split()) == 2)
    told = states(diagnosis)
    wrong = {item: (wanted.get(item), told.get(item)) for item in wanted.keys() | told.keys()}
    wrong = {item: each for item, each in wrong.items() if each[0] != each[1]}
    sentence = f"{name}: {len(told)} items of {ITEMS}; those that are otherwise (expected, reported): {wrong}"
    verdict.expect(len(told) == len(wanted) == ITEMS and not wrong, sentence)


def missing(diagnosis: dict[str, Any]) -> str:
    """What the doctor says is missing for the next tier."""
    return "; ".join(f"{each['id']}: {each['words']}" for each in diagnosis.get("missing", []))


def settings(steps: dict[str, Step], name: str) -> dict[str, str]:
    """The values that a step has listed, by file."""
    lines = steps[name].text.strip().splitlines() if name in steps else []
    return {path: value for path, _, value in (line.partition(" ") for line in lines)}


def expect_given_back(verdict: Verdict, steps: dict[str, Step], boot: str) -> int:
    """Every setting that `apply` has changed is as it was; how many there are."""
    before, after = settings(steps, "settings"), settings(steps, "settings-after")
    different = [path for path in before if after.get(path) != before[path]]
    verdict.expect(bool(before), f"{boot}: nobody looked at the settings before apply")
    verdict.expect(not different, f"{boot}: not given back by revert: {', '.join(different)}")
    made = [step for step in document(steps, "apply").get("steps", []) if step["kind"] != "file"]
    verdict.expect(bool(made), f"{boot}: apply changed no setting")
    failed = [f"{step['path']}: {step.get('reason')}" for step in made if step["outcome"] != "done"]
    verdict.expect(not failed, f"{boot}: not applied: {'; '.join(failed)}")
    tuned = settings(steps, "settings-tuned")
    untouched = [path for each in made if (path := each["path"]) in tuned and tuned[path] == before.get(path)]
    verdict.expect(bool(tuned), f"{boot}: nobody looked at the settings after apply")
    verdict.expect(not untouched, f"{boot}: apply said done, and did not change: {', '.join(untouched)}")
    return len(made)


def judge_tuned(verdict: Verdict, steps: dict[str, Step], line: str, original: dict[str, bytes]) -> None:
    """The boot with the line of `lithe tune`."""
    told, beside = document(steps, "doctor"), document(steps, "doctor-beside")
    verdict.expect(line in steps["cmdline"].text, f"the kernel was not booted with: {line}")
    verdict.expect(steps["isolated"].text.strip() == CORES, f"isolated: {steps['isolated'].text.strip()}")
    for name, each in (("before a robot runs", told), ("beside a robot", beside)):
        label = each.get("label")
        verdict.expect(label == "A-v", f"doctor {name}: tier {label}, not A-v; missing: {missing(each)}")
    expect_items(verdict, "doctor", told, steps["expected"].text)
    verdict.expect(states(beside).get("spine_pinned") == "ok", "doctor beside a robot: the Spine is not pinned")
    cpus = document(steps, "status").get("cpus", {})
    core = cpus.get("spine_core", {})
    verdict.expect(
        (cpus.get("spine"), core.get("isolation")) == (1, "boot"), f"the Spine is not on an isolated core: {cpus}"
    )
    pinned = set(steps["threads"].text.split()[1::2])
    verdict.expect("1" in pinned, f"no thread of the Spine is on core 1 only, says the kernel: {pinned}")
    plan = document(steps, "plan")
    again = [each for part in ("changes", "not_done") for each in plan.get(part, []) if each["item"] == "boot_line"]
    verdict.expect(
        bool(plan) and not again, f"after the boot, `lithe tune plan` is not content with the boot line: {again}"
    )
    count = expect_given_back(verdict, steps, "tuned boot")
    files = {path: digest for digest, path in (row.split() for row in steps["files-after"].text.strip().splitlines())}
    wanted = {
        f"/{path}": hashlib.md5(data).hexdigest() for path, data in original.items() if not path.startswith("var")
    }
    wanted.pop("/etc/debian_version")
    verdict.expect(files == wanted, f"files after revert on the board: {sorted(files)}, before: {sorted(wanted)}")
    verdict.facts |= {"label": told.get("label"), "label_beside_a_robot": beside.get("label"), "cpus": cpus}
    verdict.lines.append(
        f"isolation: tier {told.get('label')} with cores {steps['isolated'].text.strip()} isolated, Spine on core "
        f"{cpus.get('spine')} ({core.get('words')}); all {ITEMS} items of the doctor as a shell script reads them"
    )
    verdict.facts["settings_given_back"] = count


def judge_partition(verdict: Verdict, steps: dict[str, Step]) -> None:
    """The boot without isolcpus."""
    labels = {name: document(steps, f"doctor-{name}").get("label") for name in ("before", "partition", "tuned")}
    verdict.expect(steps["isolated"].text.strip() == "", f"isolated at boot: {steps['isolated'].text.strip()}")
    verdict.expect(labels["before"] in ("C-v", "D-v"), f"nothing is isolated, and the doctor says {labels['before']}")
    for name in labels:
        expect_items(verdict, name, document(steps, f"doctor-{name}"), steps[f"expected-{name}"].text)
    for name in ("partition", "tuned"):
        told = document(steps, f"doctor-{name}")
        verdict.expect(labels[name] == "B-v", f"{name}: tier {labels[name]}, not B-v; missing: {missing(told)}")
    isolation = states(document(steps, "doctor-partition"))
    verdict.expect(isolation.get("domain_isolation") == "ok", "doctor: the partition does not isolate the core")
    verdict.expect(isolation.get("isolated_partition") == "ok", "doctor: the partition is not seen")
    cpus = document(steps, "status").get("cpus", {})
    core = cpus.get("spine_core", {})
    verdict.expect((cpus.get("spine"), core.get("isolation")) == (1, "cpuset"), f"the Spine in the partition: {cpus}")
    count = expect_given_back(verdict, steps, "boot with a partition")
    verdict.facts |= {"labels_with_a_partition": labels, "settings_given_back_with_a_partition": count}
    verdict.lines.append(
        f"partition of cgroup v2 by hand, no isolcpus: tier {labels['before']}, then {labels['partition']}; Spine on "
        f"core {cpus.get('spine')} ({core.get('words')})"
    )


def judge_one_core(verdict: Verdict, steps: dict[str, Step]) -> None:
    """The boot with one core: nothing can be kept free there, that is said, and a robot runs all the same."""
    told, plan = document(steps, "doctor"), document(steps, "refused-plan").get("error", {})
    verdict.expect(steps["online"].text.strip() == "0", f"one core: online are {steps['online'].text.strip()}")
    expect_items(verdict, "one core", told, steps["expected"].text)
    label, shield = told.get("label"), steps["refused-shield"].text
    verdict.expect(label in ("C-v", "D-v"), f"one core: tier {label}")
    advised = "one core" in plan.get("message", "") and "--cores" not in plan.get("next", "--cores")
    verdict.expect(advised, f"one core: `lithe tune plan` says {plan}")
    verdict.expect("has no core of its own here" in shield, f"one core: `lithe run --shield` says {shield}")
    spine = document(steps, "status").get("cpus", {}).get("spine")
    verdict.expect(spine == 0, f"one core: the Spine is on core {spine}")
    before, after = settings(steps, "settings"), settings(steps, "settings-after")
    verdict.expect(bool(before) and before == after, f"one core: settings were {before}, and are {after}")
    verdict.facts["label_with_one_core"] = label


def run(verdict: Verdict, cache: Path, _only: str) -> None:
    """Plan, apply, boot, look, give back; then the boots with a partition and with one core."""
    kernel = kernel_of(PACKAGE, machine.AMD64, cache)
    verdict.kernel = f"Debian {kernel.release}, 4 cores"
    programs = (*need(LITHE), Path(shutil.which("bash") or "/bin/bash"))
    image = cache / "image"
    make_image(image, kernel)
    original = content(image)
    planned = tune("plan", image, "--cores", CORES)
    verdict.expect(content(image) == original, "`lithe tune plan` has changed a file")
    verdict.expect(
        [each.split()[-1] for each in planned["commands"]] == ["update-grub"],
        f"commands of the plan: {planned['commands']}",
    )
    tune("apply", image, "--cores", CORES)
    line = boot_line(image)
    robot = changed((ROOT / "robots/arm.toml").read_text(), PATIENCE | LAW).encode()
    both = {"robot.toml": robot, DOCTOR.name: DOCTOR.read_bytes()}
    profiles = {f"{HOME}/share/lithe/boards/{each.name}": each.read_bytes() for each in PROFILES.glob("*.toml")}
    tuned = {**content(image), **profiles, **both}
    tune("revert", image)
    verdict.expect(content(image) == original, "`lithe tune revert` has not given the image's bytes back")
    verdict.facts["boot_line"] = line
    boots = (
        (SCRIPT, Cargo(SCRIPT, programs, tuned, cores=4, options=line)),
        (PARTITION, Cargo(PARTITION, programs, both, cores=4, options=QUIET)),
        (ONE_CORE, Cargo(ONE_CORE, programs, both, cores=1)),
    )
    said = {}
    for script, cargo in boots:
        said[script] = machine.boot(kernel, cargo, cache)
        (cache / f"{script.stem}.log").write_text(said[script])
        verdict.expect_steps(machine.wrong_steps(said[script], script, REFUSED), script.stem, said[script])
    if verdict.wrong:
        return
    judge_tuned(verdict, machine.steps(said[SCRIPT]), line, original)
    judge_partition(verdict, machine.steps(said[PARTITION]))
    judge_one_core(verdict, machine.steps(said[ONE_CORE]))
    verdict.lines.append(
        f"tune revert: {len(original)} files of the image as before to the byte, on the board "
        f"{verdict.facts['settings_given_back']} and {verdict.facts['settings_given_back_with_a_partition']} settings; "
        f"one core: tier {verdict.facts['label_with_one_core']}, plan and shield refused with the reason, a robot runs"
    )
