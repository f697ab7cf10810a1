"""What a model file imports. Nothing else of this package is meant for model files."""

from pfaffian.derive.ir.parameter import Parameter as Parameter
from pfaffian.derive.spec.builder import ModelBuilder as ModelBuilder
from pfaffian.derive.spec.model_spec import TIME as TIME
from pfaffian.derive.spec.model_spec import Actuator as Actuator
from pfaffian.derive.spec.model_spec import Coordinate as Coordinate
from pfaffian.derive.spec.model_spec import Matrix as Matrix
from pfaffian.derive.spec.model_spec import ModelSpec as ModelSpec
from pfaffian.derive.spec.model_spec import ServoConstraint as ServoConstraint
from pfaffian.derive.spec.model_spec import StabilityCondition as StabilityCondition
from pfaffian.derive.spec.model_spec import standard_law as standard_law
from pfaffian.derive.spec.model_spec import standard_swing_up as standard_swing_up
from pfaffian.derive.spec.model_spec import symbol_of as symbol_of
from pfaffian.derive.spec.model_spec import symbols_of as symbols_of
from pfaffian.derive.spec.standard_parameters import LABORATORY as LABORATORY
from pfaffian.derive.spec.standard_parameters import Domain as Domain
from pfaffian.derive.spec.standard_parameters import SwingUpGains as SwingUpGains
from pfaffian.derive.spec.standard_parameters import swing_up_parameters as swing_up_parameters
