#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <random>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "motion/suit.h"
#include "sim/optical/virtual_rig.h"
#include "wire/photo_tag.h"
#include "wire/pseudo_terminal.h"

/// Tags that send what a virtual rig's detectors receive: the bytes of wire/photo_tag.h, late, torn
/// and in packets as Bluetooth hands them over (2.1.3, 2.3), into files or pseudo-terminals.
namespace secondskin::sim {

/// How many detectors each tag has; a rig's detectors are numbered through the tags.
std::vector<std::size_t> tag_sizes(const Suit& suit);

/// A tag's way of sending and its link.
struct TagLink {
  bool gray = false;        ///< as wire::TagFormat
  double latency = 0.015;   ///< from the end of a cycle to a packet's arrival (2.3) [s]
  double jitter = 0.0;      ///< further delay of a packet, evenly from 0; order is kept [s]
  std::size_t packet = 0;   ///< bytes that arrive together at most; 0: a whole set
  double torn_share = 0.0;  ///< share of the sets that lose a run of their bytes
  double byte_loss = 0.0;   ///< further share of bytes that are lost, each by itself
};

/// Turns a rig's cycles into packets. Deterministic for a seed. One thread.
class VirtualTags {
 public:
  /// A packet that arrives from a tag at a time [s] on the rig's clock. A tag's packets come in
  /// order and their times never go back.
  using Sink =
      std::function<void(std::size_t tag, double time, std::span<const std::uint8_t> bytes)>;

  /// @param rig  borrowed
  /// @throws std::invalid_argument when the tags' detectors are not the rig's, or a tag has none or
  ///         more than wire::kDetectorsOnATag, or a share is none.
  VirtualTags(VirtualRig& rig, std::vector<std::size_t> tag_sizes, const TagLink& link,
              std::uint64_t seed);

  std::size_t tags() const noexcept { return sizes_.size(); }
  /// The time of one cycle of the rig [s].
  double cycle_time() const noexcept { return cycle_time_; }
  /// One cycle that begins at a time [s]. A tag of which no detector received the sync bit sends
  /// nothing (2.1.3: it reads until at least one of them receives it).
  void cycle(double time, const Sink& sink);

 private:
  struct Line {
    wire::TagFormat format;
    double last_arrival = 0.0;
  };
  void send(std::size_t tag, double time, const Sink& sink);
  void lose_bytes();

  VirtualRig& rig_;
  std::vector<std::size_t> sizes_;
  TagLink link_;
  double cycle_time_;
  std::mt19937_64 random_;
  std::uniform_real_distribution<double> uniform_;
  std::vector<Line> lines_;
  std::vector<std::uint8_t> values_;
  std::vector<std::uint8_t> bytes_;
};

/// Writes what each tag sends from time 0 on into a file of its own, as fast as it can.
/// @param cycles  how many
/// @param files   one a tag; replaced
/// @throws std::system_error naming the file; std::invalid_argument on a wrong number of files
void write_tag_files(VirtualTags& tags, std::size_t cycles,
                     std::span<const std::filesystem::path> files);

/// Serves tags on pseudo-terminals in real time. All but run() may be called from any thread.
class VirtualTagsRunner {
 public:
  struct Counters {
    std::uint64_t cycles = 0;
    std::uint64_t skipped = 0;        ///< cycles that were left out because the machine was late
    std::uint64_t bytes = 0;          ///< written
    std::uint64_t dropped_bytes = 0;  ///< nobody read them in time, or the tag was unplugged
  };

  /// @param rig   borrowed; not to be used otherwise while run() runs
  /// @param links a symbolic link for each tag's terminal (PseudoTerminal), or none
  /// @throws as VirtualTags and PseudoTerminal
  VirtualTagsRunner(VirtualRig& rig, std::vector<std::size_t> tag_sizes, const TagLink& link,
                    std::uint64_t seed, std::vector<std::string> links = {});

  /// Until stopped. The scene's time 0 is when it begins.
  void run(std::stop_token stop);

  std::size_t tags() const noexcept { return tags_.tags(); }
  /// The name of a tag's terminal: its link if it has one. Empty while it is unplugged.
  std::string path(std::size_t tag) const;
  /// Hangs up whoever reads a tag; what it sends meanwhile is lost.
  void unplug(std::size_t tag);
  /// Brings it back, under the same link; without a link the name may be another.
  void plug(std::size_t tag);
  /// Darkens a projector, or lights it again.
  void darken(std::size_t projector, bool dark);
  Counters counters() const;
  /// The steady clock at the scene's time 0; empty before run() [ns].
  std::optional<std::int64_t> start_ns() const;

 private:
  struct Packet {
    double time;
    std::vector<std::uint8_t> bytes;
  };
  void write_due(double now);

  mutable std::mutex mutex_;  ///< guards all below
  VirtualRig& rig_;
  VirtualTags tags_;
  std::vector<std::string> links_;
  std::vector<std::unique_ptr<wire::PseudoTerminal>> terminals_;
  std::vector<std::deque<Packet>> pending_;
  Counters counters_;
  std::optional<std::int64_t> start_ns_;
  std::condition_variable_any wake_;
};

}  // namespace secondskin::sim
