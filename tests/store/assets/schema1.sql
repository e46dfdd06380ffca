BEGIN TRANSACTION;
CREATE TABLE experiments (
	hash VARCHAR(128) NOT NULL, 
	name VARCHAR(64) NOT NULL, 
	spec JSON NOT NULL, 
	PRIMARY KEY (hash)
);
INSERT INTO "experiments" VALUES('4be1000000000000000000000000000000000000000000000000000000000000','reach','{"version": 1, "name": "reach", "environment": {"name": "robot_task"}, "robot": {"name": "panda", "control": "cartesian"}, "task": {"name": "reach", "threshold": 0.05}, "agent": {"name": "sac", "learning_rate": 0.001, "hidden": [256, 256]}, "randomization": {}}');
INSERT INTO "experiments" VALUES('9c2e111111111111111111111111111111111111111111111111111111111111','toy','{"version": 1, "name": "toy", "environment": {"name": "toy"}, "robot": null, "task": null, "agent": {"name": "ppo", "learning_rate": 0.0003}, "randomization": {}}');
INSERT INTO "experiments" VALUES('ffff000000000000000000000000000000000000000000000000000000000000','toy','{"version": 1, "name": "gone", "environment": {"name": "toy"}, "robot": null, "task": null, "agent": {"name": "ppo", "learning_rate": 0.0003}, "randomization": {}}');
CREATE TABLE karolos_schema (
	version INTEGER NOT NULL, 
	PRIMARY KEY (version)
);
INSERT INTO "karolos_schema" VALUES(1);
CREATE TABLE runs (
	run VARCHAR(200) NOT NULL, 
	experiment VARCHAR(128) NOT NULL, 
	seed VARCHAR(64) NOT NULL, 
	state VARCHAR(16) NOT NULL, 
	steps BIGINT NOT NULL, 
	seconds FLOAT NOT NULL, 
	success_any FLOAT, 
	success_end FLOAT, 
	steps_to_95 BIGINT, 
	seconds_to_95 FLOAT, 
	name VARCHAR(64) NOT NULL, 
	episodes INTEGER, 
	environment VARCHAR(128), 
	robot VARCHAR(128), 
	task VARCHAR(128), 
	agent VARCHAR(128), 
	attempt INTEGER NOT NULL, 
	error TEXT, 
	created VARCHAR(32) NOT NULL, 
	updated VARCHAR(32) NOT NULL, 
	folder TEXT NOT NULL, 
	PRIMARY KEY (run), 
	FOREIGN KEY(experiment) REFERENCES experiments (hash)
);
INSERT INTO "runs" VALUES('reach-s0-20260101-120000','4be1000000000000000000000000000000000000000000000000000000000000','0','finished',2000,12.25,0.95,0.05,2000,12.5,'reach',20,'robot_task','panda','reach','sac',1,NULL,'2026-01-01T12:00:00.000000Z','2026-01-01T12:30:00.000000Z','/nowhere/reach-s0');
INSERT INTO "runs" VALUES('reach-s1180591620717411303424-20260102-120000','4be1000000000000000000000000000000000000000000000000000000000000','1180591620717411303424','failed',2000,12.25,NULL,NULL,NULL,NULL,'reach',NULL,'robot_task','panda','reach','sac',1,'a worker died: it''s gone; "quoted"','2026-01-02T12:00:00.000000Z','2026-01-02T12:30:00.000000Z','/nowhere/reach-s1180591620717411303424');
INSERT INTO "runs" VALUES('toy-s3-20260103-120000','9c2e111111111111111111111111111111111111111111111111111111111111','3','stopped',2000,12.25,NULL,NULL,NULL,NULL,'toy',NULL,'toy',NULL,NULL,'ppo',1,NULL,'2026-01-03T12:00:00.000000Z','2026-01-03T12:30:00.000000Z','/nowhere/toy-s3');
CREATE TABLE tests (
	run VARCHAR(200) NOT NULL, 
	steps BIGINT NOT NULL, 
	seconds FLOAT NOT NULL, 
	episodes INTEGER NOT NULL, 
	successes_any INTEGER NOT NULL, 
	successes_end INTEGER NOT NULL, 
	solved_at_reset INTEGER NOT NULL, 
	PRIMARY KEY (run, steps), 
	FOREIGN KEY(run) REFERENCES runs (run) ON DELETE CASCADE
);
INSERT INTO "tests" VALUES('reach-s0-20260101-120000',1000,6.25,20,7,1,0);
INSERT INTO "tests" VALUES('reach-s0-20260101-120000',2000,12.5,20,19,1,0);
INSERT INTO "tests" VALUES('reach-s1180591620717411303424-20260102-120000',1000,6.25,20,0,0,0);
INSERT INTO "tests" VALUES('toy-s3-20260103-120000',500,3.125,20,20,1,0);
CREATE INDEX ix_experiments_name ON experiments (name);
CREATE INDEX ix_runs_created ON runs (created);
CREATE INDEX ix_runs_state ON runs (state);
CREATE INDEX ix_runs_name ON runs (name);
CREATE INDEX ix_runs_experiment ON runs (experiment);
COMMIT;
