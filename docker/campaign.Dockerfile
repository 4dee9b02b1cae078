# What scheduler and workers of a campaign need: docker/campaign.yaml, docs/campaigns.md.
FROM debian:bookworm-slim
RUN apt-get update && apt-get install -y --no-install-recommends python3 python3-venv && rm -rf /var/lib/apt/lists/*
WORKDIR /delfim
COPY . .
RUN python3 -m venv .venv \
    && .venv/bin/pip install --require-hashes --no-deps \
        -r requirements/build.txt -r requirements/boat.txt -r requirements/campaign.txt \
    && .venv/bin/pip install --no-deps --no-build-isolation --editable .
ENV PATH=/delfim/.venv/bin:/usr/bin:/bin LANG=C.UTF-8 PYTHONUNBUFFERED=1
USER nobody
