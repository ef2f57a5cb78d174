#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "bus/messages.h"

/// Which topic carries which type: one each.
namespace secondskin::bus {

/// Every topic's short name and type name on the wire.
struct TopicInfo {
  std::string_view name;       ///< e.g. "pose"; also the name of its QoS profile
  std::string_view type_name;  ///< e.g. "secondskin_msgs::msg::dds_::SkeletonPose_"
};
inline constexpr std::array<TopicInfo, 14> kTopics{{
    {"skeleton", "secondskin_msgs::msg::dds_::SkeletonDefinition_"},
    {"pose", "secondskin_msgs::msg::dds_::SkeletonPose_"},
    {"points", "secondskin_msgs::msg::dds_::MarkerCloud_"},
    {"raw", "secondskin_msgs::msg::dds_::ProjectorValues_"},
    {"health", "secondskin_msgs::msg::dds_::ServiceHealth_"},
    {"references", "secondskin_msgs::msg::dds_::ReferenceMotionList_"},
    {"session", "secondskin_msgs::msg::dds_::SessionCommand_"},
    {"session_state", "secondskin_msgs::msg::dds_::SessionState_"},
    {"alignment", "secondskin_msgs::msg::dds_::Alignment_"},
    {"correction", "secondskin_msgs::msg::dds_::Correction_"},
    {"tactors", "secondskin_msgs::msg::dds_::TactorCommand_"},
    {"stop", "secondskin_msgs::msg::dds_::EmergencyStop_"},
    {"repetition", "secondskin_msgs::msg::dds_::RepetitionScore_"},
    {"uncertainty", "secondskin_msgs::msg::dds_::PoseUncertainty_"},
}};

/// The place of a message type's topic in kTopics.
template <class Message>
inline constexpr std::size_t kTopicOf = kTopics.size();
template <>
inline constexpr std::size_t kTopicOf<msg::SkeletonDefinition> = 0;
template <>
inline constexpr std::size_t kTopicOf<msg::SkeletonPose> = 1;
template <>
inline constexpr std::size_t kTopicOf<msg::MarkerCloud> = 2;
template <>
inline constexpr std::size_t kTopicOf<msg::ProjectorValues> = 3;
template <>
inline constexpr std::size_t kTopicOf<msg::ServiceHealth> = 4;
template <>
inline constexpr std::size_t kTopicOf<msg::ReferenceMotionList> = 5;
template <>
inline constexpr std::size_t kTopicOf<msg::SessionCommand> = 6;
template <>
inline constexpr std::size_t kTopicOf<msg::SessionState> = 7;
template <>
inline constexpr std::size_t kTopicOf<msg::Alignment> = 8;
template <>
inline constexpr std::size_t kTopicOf<msg::Correction> = 9;
template <>
inline constexpr std::size_t kTopicOf<msg::TactorCommand> = 10;
template <>
inline constexpr std::size_t kTopicOf<msg::EmergencyStop> = 11;
template <>
inline constexpr std::size_t kTopicOf<msg::RepetitionScore> = 12;
template <>
inline constexpr std::size_t kTopicOf<msg::PoseUncertainty> = 13;

template <class Message>
concept TopicMessage = kTopicOf<Message> < kTopics.size();

/// The topic's full name: rt/secondskin/<subject>/<name>.
std::string full_topic_name(std::string_view subject, std::string_view name);

/// The type's name in the IDL, for schemas: "secondskin_msgs::msg::SkeletonPose" for
/// "secondskin_msgs::msg::dds_::SkeletonPose_".
std::string idl_type_name(std::string_view type_name);

/// A message as the bytes that travel: encapsulation header, then CDR. Little-endian XCDR1.
template <TopicMessage Message>
std::vector<std::uint8_t> encode(const Message& message);

/// @returns false when the bytes are not a whole message of the type.
template <TopicMessage Message>
[[nodiscard]] bool decode(std::span<const std::uint8_t> bytes, Message& message);

}  // namespace secondskin::bus
