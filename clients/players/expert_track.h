#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>

#include "bus/messages.h"
#include "clients/dashboard/ghost.h"

/// The expert's ghost of a recording: what the bridge shows as `expert` of a live session
/// (dashboard/ghost.h), computed afterwards.
namespace secondskin::players {

/// Null or an exception where there is none of that name.
using FindReference =
    std::function<std::shared_ptr<const coach::Reference>(const std::string& name)>;
/// Told now and then, 0 to 1.
using Progress = std::function<void(double share)>;

/// Follows a session's messages in their order. One thread.
class ExpertTrack {
 public:
  explicit ExpertTrack(FindReference find) : find_(std::move(find)) {}

  void take(const bus::msg::SkeletonDefinition& body);
  void take(const bus::msg::SessionState& state);
  void take(const bus::msg::SkeletonPose& pose);
  /// The ghost of this frame; null where there is none. Valid until the next call.
  const bus::msg::SkeletonPose* take(const bus::msg::Alignment& alignment);

  /// Why there was no ghost for a reference; empty when nothing was missing.
  const std::string& missing() const noexcept { return missing_; }

 private:
  FindReference find_;
  std::string missing_;
  std::optional<Skeleton> body_;
  std::uint32_t body_id_ = 0;
  std::string name_;
  double tempo_ = 0.0;
  std::shared_ptr<const coach::Reference> reference_;
  std::optional<dashboard::Ghost> ghost_;
  StampedPose learner_, expert_;
  bool has_pose_ = false;
  bus::msg::SkeletonPose message_;
};

/// Writes the channel `expert` of a recording into a new one, at the times of its alignments.
/// @throws std::runtime_error when a file cannot be read or written, when it holds no coached
/// session, or when no reference that it names is known.
void write_expert(const std::filesystem::path& recording, const std::filesystem::path& idl,
                  const FindReference& find, const std::filesystem::path& to,
                  const Progress& progress = {}, std::stop_token stop = {});

}  // namespace secondskin::players
