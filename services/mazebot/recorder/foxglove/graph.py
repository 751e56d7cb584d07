"""Who publishes, subscribes and answers, for Foxglove's topic graph."""

from __future__ import annotations

from collections.abc import Collection

from foxglove import ConnectionGraph

from mazebot.common.messages.topics import QUERIES, TOPICS


def connection_graph(services: Collection[str]) -> ConnectionGraph:
    """The rows of the table of topics and queries that these services have a part in."""
    graph = ConnectionGraph()
    for topic in TOPICS:
        publishers = [name for name in topic.owners if name in services]
        subscribers = [name for name in topic.readers if name in services]
        if publishers:
            graph.set_published_topic(topic.name, publishers)
        if subscribers:
            graph.set_subscribed_topic(topic.name, subscribers)
    for query in QUERIES:
        if query.owner in services:
            graph.set_advertised_service(query.name, [query.owner])
    return graph
