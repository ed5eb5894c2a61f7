"""Input and output: data files, plugins, configurations, saved runs, MLflow, exports."""
