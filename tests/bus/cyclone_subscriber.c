/* Subscribes to one topic of poses with Cyclone DDS and prints what it reads:
   cyclone_subscriber DOMAIN TOPIC COUNT SECONDS */
#include <dds/dds.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

#include "secondskin_ros.h"

int main(int argc, char** argv) {
  if (argc != 5) return 2;
  const dds_entity_t participant = dds_create_participant((uint32_t)atoi(argv[1]), NULL, NULL);
  if (participant < 0) {
    fprintf(stderr, "participant: %s\n", dds_strretcode(-participant));
    return 1;
  }
  const dds_entity_t topic = dds_create_topic(
      participant, &secondskin_msgs_msg_dds__SkeletonPose__desc, argv[2], NULL, NULL);
  dds_qos_t* qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 64);
  const dds_entity_t reader = dds_create_reader(participant, topic, qos, NULL);
  dds_delete_qos(qos);
  if (topic < 0 || reader < 0) {
    fprintf(stderr, "reader: %s\n", dds_strretcode(reader < 0 ? -reader : -topic));
    return 1;
  }
  const dds_entity_t waitset = dds_create_waitset(participant);
  dds_set_status_mask(reader, DDS_DATA_AVAILABLE_STATUS);
  dds_waitset_attach(waitset, reader, reader);
  puts("ready");
  fflush(stdout);

  const int wanted = atoi(argv[3]);
  const dds_time_t end = dds_time() + DDS_SECS(atoi(argv[4]));
  int got = 0;
  while (got < wanted && dds_time() < end) {
    void* samples[64] = {NULL};
    dds_sample_info_t info[64];
    const dds_return_t n = dds_take(reader, samples, info, 64, 64);
    if (n == 0) {
      dds_attach_t news[1];
      dds_waitset_wait_until(waitset, news, 1, end);
    }
    for (dds_return_t i = 0; i < n && got < wanted; ++i) {
      if (!info[i].valid_data) continue;
      const secondskin_msgs_msg_dds__SkeletonPose_* pose = samples[i];
      printf("frame %" PRIu64 " stamp %" PRId64 " root %.6f %.6f %.6f joints %u",
             pose->header.frame, pose->header.stamp_ns, pose->root_position.x,
             pose->root_position.y, pose->root_position.z, pose->orientations._length);
      if (pose->orientations._length > 1) {
        printf(" q1 %.6f %.6f %.6f %.6f c1 %.3f", pose->orientations._buffer[1].w,
               pose->orientations._buffer[1].x, pose->orientations._buffer[1].y,
               pose->orientations._buffer[1].z, pose->confidences._buffer[1]);
      }
      putchar('\n');
      fflush(stdout);
      ++got;
    }
    if (n > 0) dds_return_loan(reader, samples, n);
  }
  dds_delete(participant);
  return got >= wanted ? 0 : 3;
}
