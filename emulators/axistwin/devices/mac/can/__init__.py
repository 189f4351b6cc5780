"""The MAC23 on a CAN bus: SDO, synchronisation, emergencies, over the axis core."""
