"""What comes in and goes out: files, plugins, configurations, saved runs, MLflow, exports."""
