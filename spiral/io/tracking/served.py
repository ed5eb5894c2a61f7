"""A saved run as an MLflow model: ``mlflow.pyfunc.load_model(uri).predict(table)``.

MLflow keeps this file with the model and runs it to load one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mlflow.models import set_model
from mlflow.pyfunc import PythonModel  # type: ignore[attr-defined]

from spiral.io.tracking.content import PLUGINS, RUN, TIME


class FreeRunModel(PythonModel):  # type: ignore[misc]
    """Free run of a fitted model on a new record.

    x' = f(x, u, p) is integrated with the fitted p from the initial state that fits the first
    ``settle`` seconds of the record best; after them the channels are never looked at.

    ``predict`` takes a table with the columns ``t`` (s, uniform), the system's channels and its
    inputs, all in the system's units, and the parameter ``settle`` (s; left out, a tenth of the
    record). It gives ``t`` and the predicted channels.
    """

    def load_context(self, context: Any) -> None:
        """Build the model again from the saved run and the plugins saved beside it."""
        from spiral.io.registry import load_registry
        from spiral.io.storage import read_run

        folder = context.artifacts.get(PLUGINS)
        registry = load_registry(folder, local=folder is not None)
        self.model = read_run(Path(context.artifacts[RUN])).model(registry)

    def predict(  # type: ignore[override]
        self, context: Any, model_input: pd.DataFrame, params: dict[str, Any] | None = None
    ) -> pd.DataFrame:
        """Predicted channels, one row for each row given.

        Raises
        ------
        InputError : a column is missing, or time is not uniform.
        """
        from spiral.inference.compare import predict
        from spiral.types.errors import InputError
        from spiral.types.record import make_record

        system = self.model.system
        table = {str(k): v.to_numpy(dtype=float) for k, v in model_input.items()}
        if TIME not in table:
            raise InputError(f"columns {', '.join(table)}", f"a column {TIME!r} with time in s")
        inputs = {i.name: table[i.name] for i in system.inputs if i.name in table}
        channels = {c: table[c] for c in system.observed if c in table}
        record = make_record(system, "served", table[TIME], channels, inputs)
        settle = (params or {}).get("settle")
        settle = None if settle is None or np.isnan(settle) else float(settle)
        run = predict(self.model, (record,), settle)
        predicted = {c: run.predicted[0][:, j] for j, c in enumerate(system.observed)}
        return pd.DataFrame({TIME: record.time, **predicted})


set_model(FreeRunModel())
