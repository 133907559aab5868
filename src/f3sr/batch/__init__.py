"""Many jobs: inputs to a dataset, one supervised process a job, on this machine or on a Ray cluster."""
