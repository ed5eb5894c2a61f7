"""Fits and scores of ``strategy=likelihood``; its rounds: ``strategies/likelihood``.

The numerics (filter, slopes, maximum) are those of ``spiral.engine.likelihood``.

Fits of a model:
``fitting``: maximum-likelihood fits of a study's state.
``seed_fit``: the seed, from several starts.
``initial_states``: initial states of the records, and the spread that a filter begins with.
``shapes``: shapes of an effect (gap, width, time constant) in a fit.
``interpolation``: how inputs run between their samples.
``noise_selection``: which random forces and which noise of sensors act.
``smaller_forces``: a large white force on hidden states replaced by a smaller one.
``free_fit``: values that minimise the free-run error.

Candidates:
``scores``: scores of all of them, none compiled for it.
``predicted_motion``: what they are scored along.
``candidates``: the race of the best.
``judging``: the winner on the blocks that did not select it.
``alternative_fits``: candidates tried on other fits of the model.
``alias_groups``: candidates that the records cannot tell apart.
``suggestions``: what is listed of a round.
``memory``: whether the missing force has memory.

A fitted model:
``comparison``: free runs, chi2 and whiteness.
``free_run_starts``: initial states of free runs.
``tied_parameters``: parameters that the records cannot tell apart.
``independence``: share of the innovations that motion and inputs explain.
``departures``: what neither the model nor its noise can hold.
"""
