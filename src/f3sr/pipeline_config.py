"""The settings of every stage of the pipeline, and those that stages share."""

from __future__ import annotations

from dataclasses import field, replace

from f3sr.background import BackgroundConfig
from f3sr.proxies import ProxyConfig
from f3sr.settings import settings
from f3sr.stages.align import AlignConfig
from f3sr.stages.assemble import AssembleConfig
from f3sr.stages.close import CloseConfig
from f3sr.stages.coarsen import CoarsenConfig
from f3sr.stages.evaluate import EvaluateConfig
from f3sr.stages.level import LevelConfig
from f3sr.stages.refine import RefineConfig
from f3sr.stages.relate import RelateConfig
from f3sr.stages.separate import SeparateConfig
from f3sr.stages.settle import SettleStageConfig
from f3sr.uncertainty.config import UncertaintyConfig


@settings
class Config:
    """The settings of every stage; ``f3sr config`` prints them with unit, range and meaning.

    Values out of range raise ValueError. Change one with ``dataclasses.replace``.
    """

    assemble: AssembleConfig = field(default_factory=AssembleConfig)
    level: LevelConfig = field(default_factory=LevelConfig)
    align: AlignConfig = field(default_factory=AlignConfig)
    relate: RelateConfig = field(default_factory=RelateConfig)
    decompose: ProxyConfig = field(default_factory=ProxyConfig)
    separate: SeparateConfig = field(default_factory=SeparateConfig)
    settle: SettleStageConfig = field(default_factory=SettleStageConfig)
    close: CloseConfig = field(default_factory=CloseConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
    coarsen: CoarsenConfig = field(default_factory=CoarsenConfig)
    uncertainty: UncertaintyConfig = field(default_factory=UncertaintyConfig)
    evaluate: EvaluateConfig = field(default_factory=EvaluateConfig)
    inpaint: BackgroundConfig = field(default_factory=BackgroundConfig)


def with_shared_settings(config: Config) -> Config:
    """The settings with one contact margin for every stage, that of the physics in which the scene settles, one kind
    of footings, that of ``separate``, and one uncertainty of poses."""
    contact = config.settle.physics.contact
    return replace(
        config,
        relate=replace(config.relate, contact=contact),
        separate=replace(config.separate, contact=contact),
        close=replace(config.close, contact=contact, footing=config.separate.footing),
        refine=replace(config.refine, contact=contact, uncertainty=config.uncertainty),
        coarsen=replace(config.coarsen, contact=contact, footing=config.separate.footing),
    )
