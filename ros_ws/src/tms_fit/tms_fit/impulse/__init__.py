"""Strike as a force of unknown onset and duration: response, priors, posterior."""
