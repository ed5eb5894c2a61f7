"""The rounds of ``strategy=likelihood``; its fits and scores: ``spiral.inference.likelihood``.

``begin_study``: the seed fitted, the candidates listed.
``propose``: a round: candidates scored, raced, refitted and tested.
``accepted``: what comes of these tests.
``admission``: the tests that a candidate must pass, and the model with it.
``meaning``: fitted values that make no sense for an effect.
``superfluous``: admitted effects that a later one makes superfluous.
``twins``: effects that do elsewhere what another does (a late sensor, a late input).
``look_alikes``: candidates that the record did not distinguish, tested again.
``other_noise``: other noise models, where no missing effect explains the residual.
``memory_rounds``: when a missing force is tested for memory.
``laws``: laws in closed form and parameters that vary, where no candidate explains the rest.
``curves``: learned curves, where no law does.
"""
