"""Commands of the plan editor: check a draft, and write it to the folder of plans."""

from collections.abc import Callable
from typing import Any

from acquisition.capture import flicker_warnings
from acquisition.plan import CapturePlan, estimate_plan, plan_entries
from standoff.console.bench_hub import BenchHub
from standoff.console.plan_drafts import DraftError, plan_of
from standoff.console.web import messages
from standoff.console.web.view_model import Document, preview_document


class PlanCommands:
    """Executes the messages about plans.

    Parameters
    ----------
    hub
        The bench.
    """

    def __init__(self, hub: BenchHub) -> None:
        self._hub = hub

    def by_message(self) -> dict[type[Any], Callable[[Any], Document]]:
        """The command of each kind of message."""
        return {
            messages.Preview: self._preview,
            messages.CheckPlan: self._check,
            messages.SavePlan: self._save,
        }

    def _preview(self, message: messages.Preview) -> Document:
        return self._cost(message.plan, self._hub.plans.load(message.plan))

    def _check(self, message: messages.CheckPlan) -> Document:
        """Say what is wrong with a draft, or what it will take."""
        try:
            plan = plan_of(message.draft)
        except DraftError as error:
            return {"type": "draft", "is_ok": False, "text": str(error), "keys": list(error.keys)}
        cost = self._cost("", plan)
        facts = {key: value for key, value in cost.items() if key not in ("type", "rows")}
        return {"type": "draft", "is_ok": True, "text": "", "keys": [], **facts}

    def _save(self, message: messages.SavePlan) -> Document:
        plan = plan_of(message.draft)
        if not message.is_replacing and self._hub.plans.has(message.name):
            return {"type": "plan-exists", "name": message.name}
        path = self._hub.plans.save(message.name, plan)
        return {"type": "plan-saved", "name": message.name, "path": str(path)}

    def _cost(self, name: str, plan: CapturePlan) -> Document:
        entries, bench = plan_entries(plan), self._hub.bench
        settings = self._hub.camera.settings
        shape = None if settings is None else (settings.height_px, settings.width_px)
        return preview_document(
            name,
            plan,
            entries,
            estimate_plan(plan, entries, bench, shape),
            tuple(flicker_warnings(plan, entries, bench)),
            free_bytes=self._hub.free_bytes(),
        )
