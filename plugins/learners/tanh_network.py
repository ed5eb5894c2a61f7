"""The paper's residual network."""

from __future__ import annotations

import itertools
import time
from typing import Any

import numpy as np

from spiral.types.learner import Learned, Learner, Tell
from spiral.types.record import Array


class TanhNetwork(Learner):
    """f(xi) = W_L tanh(... tanh(W_1 xi + b_1) ...) + b_L, one function for all equations.

    Adam on the mean squared error, stopped when the validation error has not fallen for
    ``patience`` epochs; the best epoch's weights are kept (paper, eq. nn). One thread and a seeded
    generator, so that a seed gives the same weights again.

    Fields
    ------
    width, layers : neurons in a hidden layer, and hidden layers.
    rate : Adam's first step size; it is halved when the validation error stands still.
    batch : samples in a step. epochs : at most so many passes. patience : epochs without progress.
    """

    width: int = 24
    layers: int = 2
    rate: float = 1e-2
    batch: int = 512
    epochs: int = 80
    patience: int = 10

    def fit(self, xi: Array, r: Array, train: Array, seed: int, tell: Tell) -> Learned:
        """Weights in double precision, by PyTorch."""
        import torch

        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            return self._train_network(torch, xi, r, train, seed, tell)
        finally:
            torch.set_num_threads(threads)

    def _train_network(
        self, torch: Any, xi: Array, r: Array, train: Array, seed: int, tell: Tell
    ) -> Learned:
        clock = time.perf_counter()
        generator = torch.Generator().manual_seed(seed)
        network = _build_network(torch, xi.shape[1], self.width, self.layers, r.shape[1], generator)
        parts = [torch.from_numpy(np.ascontiguousarray(a[m])) for m in (train, ~train)
                 for a in (xi, r)]  # fmt: skip
        inputs, targets, held_inputs, held_targets = parts
        adam = torch.optim.Adam(network.parameters(), lr=self.rate)
        plateau = torch.optim.lr_scheduler.ReduceLROnPlateau(
            adam, factor=0.5, patience=max(self.patience // 4, 1)
        )
        best, kept, waited, epoch = np.inf, network.state_dict(), 0, 0
        for epoch in range(1, self.epochs + 1):
            order = torch.randperm(len(inputs), generator=generator)
            for rows in order.split(self.batch):
                adam.zero_grad()
                loss = torch.mean((network(inputs[rows]) - targets[rows]) ** 2)
                loss.backward()
                adam.step()
            with torch.no_grad():
                error = float(torch.mean((network(held_inputs) - held_targets) ** 2))
            plateau.step(error)
            if error < best * (1 - 1e-4):
                best, waited = error, 0
                kept = {k: v.clone() for k, v in network.state_dict().items()}
            else:
                waited += 1
            if epoch % 10 == 0:
                tell(f"network: epoch {epoch}, validation error {best:.3g} of the variance")
            if waited >= self.patience:
                break
        network.load_state_dict(kept)
        log = {"epochs": epoch, "stopped_early": waited >= self.patience}
        return Learned(
            _network_predictor(torch, network), log | {"seconds": time.perf_counter() - clock}
        )


def _build_network(
    torch: Any, inputs: int, width: int, layers: int, outputs: int, generator: Any
) -> Any:
    """Glorot weights drawn from the generator, zero biases."""
    sizes = [inputs, *([width] * layers), outputs]
    parts: list[Any] = []
    for index, (fan_in, fan_out) in enumerate(itertools.pairwise(sizes)):
        layer = torch.nn.Linear(fan_in, fan_out, dtype=torch.float64)
        torch.nn.init.xavier_normal_(layer.weight, generator=generator)
        torch.nn.init.zeros_(layer.bias)
        parts += [layer, torch.nn.Tanh()] if index < layers else [layer]
    return torch.nn.Sequential(*parts)


def _network_predictor(torch: Any, network: Any) -> Any:
    def predict(points: Array) -> Array:
        with torch.no_grad():
            return network(torch.from_numpy(np.ascontiguousarray(points))).numpy()

    return predict
