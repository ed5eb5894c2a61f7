"""What each strategy does in a round; their options are the plugins ``plugins/strategies``.

``base``: the interface of a strategy.
``likelihood``: the default, by the likelihood of one-step predictions.
``shooting``: by trajectories, fitted on windows.
``innovation``: by the innovations of a Kalman filter.
``paper``: by differentiated data, as in the paper SPIRAL-PO.
"""
