"""Documents that show generated code show the code as it is."""

from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_the_listing_in_the_documents_is_the_generated_step():
    code = (ROOT / "generated/pendubot/c/pendubot.c").read_text(encoding="utf-8")
    step = code[code.rindex("pendubot_status_t pendubot_step(") :].strip()
    page = (ROOT / "docs/emitted-code.md").read_text(encoding="utf-8")
    assert page.split("```c\n")[1].split("```")[0].strip() == step


def test_the_operations_in_the_documents_are_those_of_the_passes():
    from pfaffian.derive.pipeline import lowered_model
    from pfaffian.derive.spec.library import find_model

    reports = [p for p in lowered_model(find_model("pendubot")).passes if p.program == "step"]
    page = (ROOT / "docs/emitted-code.md").read_text(encoding="utf-8")
    shown = " ".join(page.split("    operations a step: ")[1].split("\n\n")[0].split())
    after = ", ".join(f"{p.name} {p.after}" for p in reports)
    assert shown == f"{reports[0].before}; after {after}"
