"""The creative memory: recalled actions, and ideas made by noise in its connections (section 3)."""

from __future__ import annotations

import torch
from torch import Tensor

from .networks import ACTIVATIONS, SGD, Adam, Networks, Optimizer, Rate
from .parameters import Parameters


class CreativeMemory:
    """Networks that map a state to two logistic outputs, the motor values (section 3).

    Attributes:
      networks: One network for each of B robots.
      optimizer: `Adam` if the parameters have `optimizer` "adam" and `memory_target` "best", else
        `SGD`.
      patterns: Source of the noise patterns, one for each idea.
    """

    def __init__(
        self, parameters: Parameters, robots: int, inputs: int, generator: torch.Generator
    ) -> None:
        """Draws the initial networks.

        Args:
          parameters: Parameters of the brain, such as `memory_hidden`, `memory_target` and `noise`.
          robots: Number B of robots.
          inputs: Number I of network inputs for the state.
          generator: Random stream of the initial weights and of the noise.
        """
        self._parameters = parameters
        hidden, initial_range = parameters.memory_hidden, parameters.initial_range
        self.networks = Networks(robots, inputs, hidden, 2, initial_range, generator)
        self.networks.activation = ACTIVATIONS[parameters.activation]
        # Adam normalises the step size and would discard the magnitude of the TD error.
        adam = parameters.optimizer == "adam" and parameters.memory_target == "best"
        self.optimizer: Optimizer = Adam(self.networks) if adam else SGD(self.networks)
        # Connections in each part of a pattern: hidden, output weights (hidden, output biases).
        self._sizes = [hidden * inputs, 2 * hidden]
        if parameters.noise_on_biases:
            self._sizes += [hidden, 2]
        fixed = parameters.noisy_connections == "fixed"
        patterns = NoisePatterns(
            sum(self._sizes),
            parameters.noisy_share,
            parameters.noise,
            generator,
            robots if fixed else 0,
        )
        self.patterns: NoisePatterns | HeldNoisePatterns = patterns
        if parameters.noise_steps != 1:
            count = robots * parameters.own_ideas
            self.patterns = HeldNoisePatterns(patterns, count, parameters.noise_steps)

    def ideas(self, state: Tensor, count: int) -> Tensor:
        """Returns ideas: outputs of the memory, each with its own noise in the connections.

        Args:
          state: Network inputs, shape (B, I).
          count: Number A of ideas per robot.

        Returns:
          Motor values in [-0.5, 0.5], shape (B, A, 2).
        """
        robots, inputs = state.shape
        hidden_size = self._parameters.memory_hidden
        patterns = self.patterns.draw(robots * count).view(robots, count, -1)
        if self._parameters.keep_main_idea:
            patterns[:, 0].zero_()
        noise = patterns.split(self._sizes, dim=-1)
        net = self.networks

        # (W + N) x = W x + N x: adding the sums avoids building the noisy networks.
        main = torch.baddbmm(net.hidden_biases[..., None], net.hidden_weights, state[..., None])
        noise_in = noise[0].reshape(robots, count * hidden_size, inputs)
        sums = torch.bmm(noise_in, state[..., None]).view(robots, count, hidden_size)
        sums += main.mT
        if self._parameters.noise_on_biases:
            sums += noise[2]
        hidden = net.activation.apply(sums)

        outputs = torch.baddbmm(net.output_biases[:, None], hidden, net.output_weights.mT)
        noise_out = noise[1].view(robots, count, 2, hidden_size)
        outputs += (noise_out * hidden[:, :, None]).sum(-1)
        if self._parameters.noise_on_biases:
            outputs += noise[3]
        return outputs.sigmoid_() - 0.5

    def learn(self, state: Tensor, action: Tensor, factors: Tensor, rate: Rate = 1.0) -> None:
        """Learns an action by a step of back-propagation on half the squared error of the outputs.

        Args:
          state: Network inputs, shape (B, I).
          action: Motor values to learn, shape (B, 2).
          factors: Factor of each robot's learn rate, shape (B,); negative to unlearn the action, 0
            for a robot that does not learn. With Adam, only 1 or 0.
          rate: Learn rate before it is multiplied by `factors`: a number, or a tensor of shape ().
        """
        hidden, sums = self.networks.forward(state)
        outputs = sums.sigmoid()
        steps = factors[:, None] * (action + 0.5 - outputs) * outputs * (1 - outputs)
        self.optimizer.ascend(state, hidden, steps, rate, factors)


class NoisePatterns:
    """Noise patterns, one for each idea: which connections are noisy, and the sign of the noise.

    In a pattern, exactly n = round(share * N) of N connections have +noise or -noise (at least 1 if
    the share is above 0), the others 0; positions and signs are uniform. A pool of `POOL` patterns
    is drawn at once and redrawn every `LIFETIME` steps; every idea takes a random one of them. Each
    idea is distributed as if drawn individually, but for 50 robots or more, the draws take a tenth
    of the time. Two ideas take the same pattern with a probability of 1 in `POOL`, so they are
    equal more often than individual draws would be.

    With fixed connections, each robot's noisy connections are drawn once; a pattern of the pool
    then holds only the signs of their noise.

    Attributes:
      fixed: Indices of each robot's noisy connections, int64, shape (B, n); shape (0, n) if they
        are drawn anew for each idea.
    """

    POOL = 16384
    LIFETIME = 500

    def __init__(
        self,
        connections: int,
        share: float,
        noise: float,
        generator: torch.Generator,
        robots: int = 0,
    ) -> None:
        """Prepares patterns; the first `renew` fills the pool.

        Args:
          connections: Number N of connections of a robot's memory that can be noisy.
          share: Share of the N connections that are noisy in a pattern, in [0, 1].
          noise: Magnitude of the noise, which is added to or subtracted from a noisy connection.
          generator: Random stream that draws the noisy connections, the signs of their noise, and
            the pattern of each idea.
          robots: Number B of robots if each robot has fixed noisy connections; 0 if they are
            drawn anew for each idea.
        """
        self.connections = connections
        self.noisy = max(round(share * connections), 1 if share > 0 else 0)
        self.noise = noise
        self._generator = generator
        keys = torch.rand(robots, connections, generator=generator)
        self.fixed = keys.topk(self.noisy, dim=1, largest=False).indices
        self._pool = torch.zeros(self.POOL, self.noisy if robots else connections)
        self._age = torch.tensor([self.LIFETIME], device="cpu")  # the host reads it in every step

    def renew(self, steps: int = 1) -> int:
        """Redraws the pool after `LIFETIME` steps; must be called before each step with draws.

        Returns:
          The number of steps for which the pool lasts, from 1 to `steps`.
        """
        if self._age >= self.LIFETIME:
            self._refill()
        lasts = min(steps, self.LIFETIME - int(self._age))
        self._age += lasts
        return lasts

    def draw(self, count: int) -> Tensor:
        """Draws patterns, shape (count, N); with fixed connections, equally many for each robot."""
        drawn = self._pool.index_select(0, self.rows(count))
        if not len(self.fixed):
            return drawn
        own = self.fixed.repeat_interleave(count // len(self.fixed), dim=0)
        return drawn.new_zeros(count, self.connections).scatter_(1, own, drawn)

    def rows(self, count: int) -> Tensor:
        """Draws row numbers of patterns in the pool, shape (count,)."""
        generator, device = self._generator, self._pool.device
        return torch.randint(self.POOL, (count,), generator=generator, device=device)

    def _refill(self) -> None:
        generator, device = self._generator, self._pool.device
        chosen = torch.arange(self.noisy, device=device).expand(len(self._pool), -1)
        if not len(self.fixed):
            keys = torch.rand(self._pool.shape, generator=generator, device=device)
            chosen = keys.topk(self.noisy, dim=1, largest=False).indices
        signs = torch.randint(2, chosen.shape, generator=generator, device=device) * 2.0 - 1.0
        self._pool.zero_().scatter_(1, chosen, self.noise * signs)
        self._age.zero_()

    def tensors(self) -> dict[str, Tensor]:
        """Returns the pool, its age in steps, and fixed connections, for a checkpoint."""
        fixed = {"fixed": self.fixed} if len(self.fixed) else {}
        return {"pool": self._pool, "age": self._age} | fixed


class HeldNoisePatterns:
    """Noise patterns that ideas keep for several steps, or for life.

    The paper says how much noise an idea has, not when the noise is drawn anew.
    """

    def __init__(self, patterns: NoisePatterns, count: int, steps: int) -> None:
        """Prepares patterns to hold; the first `renew` draws them.

        Args:
          patterns: Noise patterns from which the held ones are drawn.
          count: Number of patterns that are held: one for each idea of each robot.
          steps: Number of steps for which a pattern is held; 0 to hold it for the whole life.
        """
        self._patterns = patterns
        self._steps = steps
        self._held = torch.zeros(count, patterns.connections)
        # Steps before the next draw, -1 for life; the host reads them in every step.
        self._left = torch.tensor([0], device="cpu")

    def renew(self) -> None:
        """Redraws the patterns every `steps` steps; must be called before each step with draws."""
        if self._left == 0:
            self._patterns.renew()
            self._held.copy_(self._patterns.draw(len(self._held)))
            self._left.fill_(self._steps or -1)
        if self._steps:
            self._left -= 1

    def draw(self, count: int) -> Tensor:
        """Returns the held patterns, shape (count, N); `count` must be their number."""
        return self._held.clone()

    def tensors(self) -> dict[str, Tensor]:
        """Returns the held patterns and those from which they are drawn, for a checkpoint."""
        return self._patterns.tensors() | {"held": self._held, "left": self._left}
